"""A Modbus bus among late, doubled, bent and foreign replies returns no wrong value as good."""

from __future__ import annotations

import asyncio
import random
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.bus import Bus
from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.links import open_link
from drivers.modbus import BusTally, Echo, Framing, ModbusBus, rtu_silence_s

TIMEOUT_S = 0.1
LATE_S = 0.12
PATIENCE_S = 10.0  # a deadline that only a broken bus reaches
SLOWEST_S = 0.15
READS = 3000


def register(device_id: int, address: int) -> int:
    """What a register holds: itself, so that any mix-up shows."""
    return (device_id * 40503 + address * 2654435761) >> 5 & 0xFFFF


@dataclass
class Clock:
    """Time that passes only when somebody waits."""

    now_s: float = 1000.0
    longest_sleep_s: float = 0.0

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        self.longest_sleep_s = max(self.longest_sleep_s, seconds)


Delivery = tuple[float, bytes]  # seconds after the request, bytes
Behaviour = Callable[[ModbusPDU, Callable[[ModbusPDU], bytes]], list[Delivery]]


@dataclass
class Device:
    """A link with devices at its end that behave as told, in virtual time."""

    clock: Clock
    behaviour: Behaviour
    framing: Framing = Framing.RTU
    address: str = "virtual"
    sent: list[tuple[float, bytes]] = field(default_factory=list)
    coming: list[Delivery] = field(default_factory=list)

    def write(self, data: bytes) -> None:
        framer = FramerRTU if self.framing is Framing.RTU else FramerSocket
        codec = framer(DecodePDU(is_server=True))
        self.sent.append((self.clock(), data))
        _, request = codec.handleFrame(data, 0, 0)
        assert request is not None
        for delay_s, reply in self.behaviour(request, codec.buildFrame):
            self.coming.append((self.clock() + delay_s, reply))
        self.coming.sort(key=lambda delivery: delivery[0])

    def read(self, timeout_s: float) -> bytes:
        until_s = self.clock() + timeout_s
        if not self.coming or self.coming[0][0] > until_s:
            self.clock.now_s = until_s
            return b""
        at_s, data = self.coming.pop(0)
        self.clock.now_s = max(self.clock.now_s, at_s)
        return data

    def close(self) -> None:
        pass


def truth(request: ModbusPDU) -> ModbusPDU:
    """The right answer to a read of holding registers."""
    values = [register(request.dev_id, request.address + k) for k in range(request.count)]
    return ReadHoldingRegistersResponse(
        dev_id=request.dev_id, transaction_id=request.transaction_id, registers=values
    )


def honest(request: ModbusPDU, frame: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
    return [(0.01, frame(truth(request)))]


def mute(_: ModbusPDU, __: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
    return []


def vicious(noise: random.Random, framing: Framing) -> Behaviour:
    """Late 20 %, doubled 10 %, bent, cut, foreign, behind garbage, or missing 5 % each."""

    def behave(request: ModbusPDU, frame: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
        delay_s = LATE_S if noise.random() < 0.2 else noise.uniform(0.002, 0.05)
        reply = frame(truth(request))
        if noise.random() < 0.05:
            return []
        # A TCP connection bends and cuts nothing; its devices still mix up ids and speak unasked.
        if framing is Framing.RTU and noise.random() < 0.05:
            reply = bent(reply, noise)
        if framing is Framing.RTU and noise.random() < 0.05:
            reply = reply[: noise.randrange(len(reply))]
        if noise.random() < 0.05:
            reply = noise.randbytes(noise.randrange(1, 12)) + reply
        if noise.random() < 0.05:
            request.dev_id += 1
            reply = frame(truth(request)) + (reply if noise.random() < 0.5 else b"")
        again = [(delay_s + 0.003, reply)] if noise.random() < 0.1 else []
        return dribbled(delay_s, reply, noise) + again

    return behave


def bent(frame: bytes, noise: random.Random) -> bytes:
    bits = bytearray(frame)
    bits[noise.randrange(len(bits))] ^= 1 << noise.randrange(8)
    return bytes(bits)


def dribbled(delay_s: float, frame: bytes, noise: random.Random) -> list[Delivery]:
    cut = noise.randrange(len(frame) + 1)
    return [(delay_s, part) for part in (frame[:cut], frame[cut:]) if part]


def bus_to(device: Device, *, slowest_s: float = SLOWEST_S, silence_s: float = 0.005) -> ModbusBus:
    return ModbusBus(
        device,
        device.framing,
        timeout_s=TIMEOUT_S,
        slowest_reply_s=slowest_s,
        silence_s=silence_s,
        clock=device.clock,
        sleep=device.clock.sleep,
    )


@dataclass
class Outcome:
    good: int = 0
    wrong: int = 0
    errors: int = 0
    tally: BusTally = field(default_factory=BusTally)


def read_much(framing: Framing, **rules: float) -> Outcome:
    """Thousands of reads from vicious devices, counted by what came of them."""
    noise = random.Random(20)
    device = Device(Clock(), vicious(noise, framing), framing)
    bus = bus_to(device, **rules)
    outcome = Outcome()
    for _ in range(READS):
        device_id, first = noise.choice([7, 9]), noise.randrange(0x7000)
        count = noise.choice([1, 2, 4])
        try:
            values = bus.read_holding(device_id, first, count)
        except (NoReply, FrameError):
            outcome.errors += 1
            continue
        right = values == tuple(register(device_id, first + k) for k in range(count))
        outcome.good += right
        outcome.wrong += not right
    outcome.tally = bus.tally()
    return outcome


@pytest.mark.parametrize("framing", Framing)
def test_vicious_devices_get_no_wrong_value_through(framing: Framing) -> None:
    outcome = read_much(framing)
    assert outcome.wrong == 0
    assert outcome.good + outcome.errors == READS
    assert outcome.good > 0.75 * READS
    tally = outcome.tally
    assert tally.requests == READS + tally.retries
    # Failures are retried, the last one is an honest error.
    assert tally.no_replies + tally.frame_errors == tally.retries + outcome.errors
    assert min(tally.no_replies, tally.frame_errors, tally.discarded_bytes) > 100


def test_an_answer_is_good_only_when_none_follows_it() -> None:
    """A doubled question is answered twice, the second time with what the register is by then."""
    asked = 0

    def moving(request: ModbusPDU, frame: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
        nonlocal asked
        asked += 1
        values = ReadHoldingRegistersResponse(dev_id=7, registers=[100 * asked])
        again = ReadHoldingRegistersResponse(dev_id=7, registers=[100 * asked + 1])
        if asked == 2:
            return [(0.001, frame(again)), (0.004, frame(values))]
        return [(0.003, frame(values))]

    bus = bus_to(Device(Clock(), moving))
    assert bus.read_holding(7, 0, 1) == (100,)
    assert bus.read_holding(7, 1, 1) == (300,)  # asked again: of two answers neither was believed


def test_the_bus_speaks_again_only_after_the_slowest_reply() -> None:
    device = Device(Clock(), mute)
    bus = bus_to(device)
    opened_s = device.clock()
    with pytest.raises(NoReply, match=r"virtual: device 7, read 2 holding from 0x6002.*powered"):
        bus.read_holding(7, 0x6002, 2)
    first_s, second_s, third_s = (at_s for at_s, _ in device.sent)
    assert third_s - second_s >= TIMEOUT_S + SLOWEST_S
    assert first_s - opened_s >= SLOWEST_S  # somebody may have asked before us
    assert second_s - first_s >= TIMEOUT_S + SLOWEST_S
    assert device.clock.longest_sleep_s <= 0.05


def test_after_an_early_error_the_quarantine_counts_from_the_error() -> None:
    device = Device(Clock(), lambda *_: [(0.01, b"U")])
    with pytest.raises(FrameError):
        bus_to(device).read_holding(7, 0, 1)
    first_s, second_s, third_s = (at_s for at_s, _ in device.sent)
    assert 0.01 + SLOWEST_S <= second_s - first_s < TIMEOUT_S + SLOWEST_S
    assert 0.01 + SLOWEST_S <= third_s - second_s < TIMEOUT_S + SLOWEST_S


def test_an_interrupt_amid_a_request_leaves_no_reply_for_the_next_one() -> None:
    device = Device(Clock(), honest)
    bus = bus_to(device)
    assert bus.read_holding(7, 0, 1) == (register(7, 0),)

    def interrupting(request: ModbusPDU, frame: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
        device.coming = [(device.clock() + 0.008, frame(truth(request)))]
        device.behaviour = honest
        raise KeyboardInterrupt

    device.behaviour = interrupting
    with pytest.raises(KeyboardInterrupt):
        bus.read_holding(7, 0x50, 1)
    assert bus.read_holding(7, 0x100, 1) == (register(7, 0x100),)


def test_a_write_is_sent_once_whatever_comes_back() -> None:
    device = Device(Clock(), mute)
    with pytest.raises(NoReply):
        bus_to(device).write_registers(7, 0x6200, [1, 2])
    device.behaviour = lambda request, frame: [(0.01, bent(frame(request), random.Random(1)))]
    with pytest.raises(FrameError):
        bus_to(device).write_register(7, 0x6002, 0x10)
    assert len(device.sent) == 2


def test_a_writes_echo_must_be_the_write() -> None:
    def other_value(request: ModbusPDU, frame: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
        request.registers = [request.registers[0] + 1]
        return [(0.01, frame(request))]

    device = Device(Clock(), other_value)
    with pytest.raises(FrameError, match="was due"):
        bus_to(device).write_register(7, 0x6002, 0x10)


def refusing(code: int) -> Behaviour:
    def behave(request: ModbusPDU, frame: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
        return [(0.01, frame(ExceptionResponse(request.function_code, code, request.dev_id)))]

    return behave


@pytest.mark.parametrize(
    ("code", "name", "asked"),
    [(2, "illegal data address", 1), (8, "bad CRC", 3), (6, "busy", 3), (99, "manual", 1)],
)
def test_a_refusal_says_its_code_and_only_a_passing_one_is_asked_again(code, name, asked) -> None:
    device = Device(Clock(), refusing(code))
    with pytest.raises(Refused, match=f"code {code} .*{name}") as refusal:
        bus_to(device).read_holding(7, 0, 1)
    assert refusal.value.code == code
    assert len(device.sent) == asked


def test_a_line_that_never_falls_silent_is_an_error_and_nothing_is_sent() -> None:
    device = Device(Clock(), honest)
    device.coming = [(1000 + k * 0.001, b"U") for k in range(20_000)]
    with pytest.raises(FrameError, match="another master"):
        bus_to(device).write_coil(1, 0, value=False)
    assert device.sent == []


@pytest.mark.parametrize("echo", Echo)
def test_the_local_echo_of_an_adapter_is_discarded_if_it_is_said_to_be_there(echo: Echo) -> None:
    def echoing(request: ModbusPDU, frame: Callable[[ModbusPDU], bytes]) -> list[Delivery]:
        return [(0.001, frame(request)), *honest(request, frame)]

    device = Device(Clock(), echoing)
    times = {"timeout_s": TIMEOUT_S, "slowest_reply_s": SLOWEST_S}
    bus = ModbusBus(device, echo=echo, clock=device.clock, sleep=device.clock.sleep, **times)
    if echo is Echo.DISCARDED:
        assert bus.read_holding(7, 5, 3) == tuple(register(7, k) for k in (5, 6, 7))
    else:
        with pytest.raises(FrameError):
            bus.read_holding(7, 5, 3)


@pytest.mark.parametrize(
    "mistake",
    [
        lambda bus: bus.read_holding(7, 0, 126),
        lambda bus: bus.read_input(7, 0, 0),
        lambda bus: bus.read_coils(0, 0, 1),
        lambda bus: bus.read_holding(248, 0, 1),
        lambda bus: bus.read_holding(7, 0xFFFF, 2),
        lambda bus: bus.write_registers(7, 0, [0] * 124),
        lambda bus: bus.write_registers(7, 0, []),
        lambda bus: bus.write_registers(7, 0, [0, -1]),
        lambda bus: bus.write_register(7, 0, 0x10000),
        lambda bus: bus.write_coil(7, -1, value=True),
    ],
)
def test_a_callers_mistake_is_a_value_error_before_a_byte_is_sent(mistake) -> None:
    device = Device(Clock(), honest)
    with pytest.raises(ValueError, match=r"not|holds|no 16-bit"):
        mistake(bus_to(device))
    assert device.sent == []


def test_the_silence_is_three_and_a_half_characters_or_5_ms() -> None:
    assert rtu_silence_s(115200) == 0.005
    assert rtu_silence_s(4800) == pytest.approx(0.00802, abs=1e-5)


@contextmanager
def independent_server(*devices: SimDevice) -> Iterator[str]:
    """A pymodbus server on a free port of loopback, in a thread of its own; its address."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    async def serve() -> ModbusTcpServer:
        server = ModbusTcpServer(context=list(devices), address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        return server

    server = asyncio.run_coroutine_threadsafe(serve(), loop).result(10)
    try:
        yield f"tcp://127.0.0.1:{server.transport.sockets[0].getsockname()[1]}"
    finally:
        asyncio.run_coroutine_threadsafe(server.shutdown(), loop).result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10)
        loop.close()


@pytest.fixture
def server() -> Iterator[str]:
    holding = SimData(0x6200, values=list(range(100, 108)), datatype=DataType.REGISTERS)
    inputs = SimData(200, values=[0x1234, 0xFFFF], datatype=DataType.REGISTERS)
    coils = SimData(0, values=[True, False, True, True], count=3, datatype=DataType.BITS)
    contacts = SimData(0, values=[False], datatype=DataType.BITS)
    with independent_server(SimDevice(7, ([coils], [contacts], [holding], [inputs]))) as address:
        yield address


@pytest.fixture
def bus(server: str) -> Iterator[Bus]:
    link = open_link(server)
    yield ModbusBus(link, Framing.TCP, timeout_s=5.0, slowest_reply_s=0.1)
    link.close()


def test_an_independent_server_is_read(bus: Bus) -> None:
    assert bus.read_input(7, 200, 2) == (0x1234, 0xFFFF)
    assert bus.read_coils(7, 0, 11) == (True, False, True, True) * 2 + (True, False, True)
    assert bus.read_holding(7, 0x6207, 1) == (107,)


def test_an_independent_server_is_written(bus: Bus) -> None:
    bus.write_registers(7, 0x6200, [0xDEAD, 0xBEEF])
    bus.write_register(7, 0x6203, 0x0210)
    assert bus.read_holding(7, 0x6200, 4) == (0xDEAD, 0xBEEF, 102, 0x0210)
    bus.write_coil(7, 3, value=False)
    assert bus.read_coils(7, 2, 3) == (True, False, True)


def test_an_independent_server_refuses_what_it_has_not(bus: Bus) -> None:
    with pytest.raises(Refused, match="illegal data address") as refusal:
        bus.read_holding(7, 0x7000, 2)
    assert refusal.value.code == 2


class TwoAskers:
    """A link on which a second thread tries to ask while the first one waits for its answer."""

    address = "shared"

    def __init__(self) -> None:
        self.second = threading.Thread(target=self.ask)
        self.asked: list[int] = []
        self.got: list[tuple[int, ...]] = []
        self.overlapped: bool | None = None
        self._second_asked = threading.Event()
        self._replies: dict[int, bytes] = {}
        self.bus = ModbusBus(
            self, Framing.TCP, timeout_s=PATIENCE_S, slowest_reply_s=0.0, clock=self.clock
        )

    def clock(self) -> float:
        """For the second thread the first one's quarantine is long over: only the lock holds it."""
        return 2 * PATIENCE_S if threading.current_thread() is self.second else 0.0

    def ask(self) -> None:
        self.got.append(self.bus.read_holding(7, len(self.asked), 1))

    def write(self, data: bytes) -> None:
        codec = FramerSocket(DecodePDU(is_server=True))
        _, request = codec.handleFrame(data, 0, 0)
        assert request is not None
        self.asked.append(request.address)
        self._replies[threading.get_ident()] = codec.buildFrame(truth(request))
        if len(self.asked) == 2:
            self._second_asked.set()

    def read(self, _: float) -> bytes:
        if self._replies and self.overlapped is None:
            self.overlapped = False
            self.second.start()
            self.overlapped = self._second_asked.wait(0.2)
        return self._replies.pop(threading.get_ident(), b"")

    def close(self) -> None:
        pass


def test_a_second_thread_asks_only_when_the_first_has_its_answer() -> None:
    link = TwoAskers()
    link.ask()
    link.second.join(PATIENCE_S)
    assert link.overlapped is False
    assert link.got == [(register(7, 0),), (register(7, 1),)]


def test_a_server_that_goes_is_a_lost_link() -> None:
    with independent_server(SimDevice(1, [SimData(0, datatype=DataType.REGISTERS)])) as address:
        link = open_link(address)
        bus = ModbusBus(link, Framing.TCP, timeout_s=5.0, slowest_reply_s=0.1)
        assert bus.read_holding(1, 0, 1) == (0,)
    with pytest.raises(LinkLost):
        bus.read_holding(1, 0, 1)
    link.close()
