"""Ten thousand questions in every protocol that has a checksum, over real ptys and TCP connections.

    python -m tests.campaigns.questions [--questions 10000] [--protocols rtu,tcp] [--seed 1]

Wires and devices are a process of their own; the questions are dealt out to some wires at a time,
most of whose time is waiting. Every device answers with numbers that follow from the question, so
that an answer to another one shows. `tests/drivers/test_bad_wires.py` asks the same in virtual
time. It exits 1 when a wrong value was returned as a good one, or a wire answered next to nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from drivers.errors import DriverError, LinkLost
from drivers.hokuyo.line import ScipLine
from drivers.hokuyo.wire import Window, scan_command, scan_of
from drivers.links import ByteLink, open_link
from drivers.modbus import Framing, ModbusBus
from drivers.sick.line import Question, SickLine
from drivers.sick.wire import Size, memory_read
from drivers.zaber import Chain
from sim.device import Device
from sim.faulty_wire import FaultyLine, Plug
from sim.lasers import Slow as PacedLine
from sim.modbus import RtuServer, TcpSession
from sim.serving import Ending, Server
from sim.wire_faults import Carrier, WireFaults
from sim.wires import Pty, TcpListener
from sim.zaber import ZaberChain
from tests.campaigns.numbered import (
    Memory,
    NumberedScanner,
    NumberedStage,
    NumberedUnit,
    number,
    range_of,
)
from tests.campaigns.victims import REPOSITORY
from tests.drivers.virtual_wire import Slow

CHANCES = MappingProxyType(
    {"late": 0.2, "flip": 0.05, "twice": 0.1, "drop": 0.02, "cut": 0.05, "swap": 0.02,
     "split": 0.1, "noise": 0.05, "mute": 0.001}
)  # fmt: skip
LATENCY_S = 0.002
TIMEOUT_S, SLOWEST_S = 0.1, 0.42  # of a bus; late there and back, overtaken, doubled, split
_BAUD = 115200
_START_S = 30.0
_LEAST_RIGHT = 0.3


@dataclass(frozen=True)
class Protocol:
    """A way to ask, and who answers.

    ``late_s`` is above what its driver waits for an answer, so that a late one meets the next
    question.
    """

    late_s: float
    device: Callable[[], Device]
    asking: Callable[[ByteLink], Callable[[random.Random], bool]]  # whether an answer was right
    carrier: Carrier = Carrier.SERIAL


def _registers(framing: Framing) -> Callable[[ByteLink], Callable[[random.Random], bool]]:
    def asking(link: ByteLink) -> Callable[[random.Random], bool]:
        bus = ModbusBus(link, framing, timeout_s=TIMEOUT_S, slowest_reply_s=SLOWEST_S)

        def ask(dice: random.Random) -> bool:
            first, count = dice.randrange(60_000), dice.randrange(1, 5)
            values = bus.read_holding(1, first, count)
            return values == tuple(number(first + k) for k in range(count))

        return ask

    return asking


def _settings(link: ByteLink) -> Callable[[random.Random], bool]:
    chain = Chain(link)
    chain.expect_checks(1)

    def ask(dice: random.Random) -> bool:
        place = dice.randrange(60_000)
        return chain.ask(1, 1, f"get number.{place}").data == str(number(place))

    return ask


def _memory(link: ByteLink) -> Callable[[random.Random], bool]:
    line, before = SickLine(link, baud=_BAUD), deque[int](maxlen=2)

    def ask(dice: random.Random) -> bool:
        # As the driver reads a profile: no answer is as long as those of the last two questions.
        place = dice.randrange(60_000)
        count = dice.choice([size for size in range(120, 127) if size not in before])
        before.append(count)
        said = line.ask(Question(memory_read(place, count, Size.POINT), 4 * count))
        return said == b"".join(number(place + k).to_bytes(2, "big") for k in range(2 * count))

    return ask


def _ranges(link: ByteLink) -> Callable[[random.Random], bool]:
    line = ScipLine(link)

    def ask(dice: random.Random) -> bool:
        first = dice.randrange(44, 700)
        window = Window(first, first + dice.randrange(1, 25))
        ranges = scan_of(line.ask(scan_command(window)), window).ranges
        return ranges.tolist() == [range_of(step) for step in range(first, window.last + 1)]

    return ask


PROTOCOLS = {
    "rtu": Protocol(0.12, lambda: RtuServer({1: NumberedUnit()}), _registers(Framing.RTU)),
    "tcp": Protocol(
        0.12, lambda: TcpSession({1: NumberedUnit()}), _registers(Framing.TCP), Carrier.TCP
    ),
    "zaber": Protocol(0.6, lambda: ZaberChain({1: NumberedStage()}), _settings),  # type: ignore[dict-item]
    # Paced: the lengths of its answers tell them apart for as long as two of them take.
    "sick": Protocol(0.12, lambda: PacedLine(Memory(), _BAUD), _memory),
    "scip": Protocol(0.15, NumberedScanner, _ranges),
}


# --- the answering end ---------------------------------------------------------------------------


def serve(name: str, wires: int, seed: int, folder: Path) -> None:
    """Serve a protocol on so many bad wires until stdin is closed; tell what struck at last."""
    protocol, ending = PROTOCOLS[name], Ending()
    faults = WireFaults(chances=CHANCES, late_s=protocol.late_s)
    plugs = [Plug(f"wire {k}") for k in range(wires)]
    with Server(lively=lambda _: True) as server:
        addresses = [_laid(protocol, faults, plug, seed, server, folder) for plug in plugs]
        server.end_with(0, ending)
        sys.stdout.write(json.dumps(addresses) + "\n")
        sys.stdout.flush()
        server.run(ending)
    struck = sum((plug.happened for plug in plugs), Counter[str]())
    sys.stdout.write(json.dumps(struck) + "\n")


def _laid(
    protocol: Protocol, faults: WireFaults, plug: Plug, seed: int, server: Server, folder: Path
) -> str:
    connections = iter(range(1 << 30))

    def line() -> Device:
        dice = random.Random(f"{seed} {plug.name} {next(connections)}")
        slow = Slow(protocol.device(), LATENCY_S)
        return FaultyLine(slow, faults, protocol.carrier, plug, dice)

    if protocol.carrier is Carrier.TCP:
        listener = TcpListener()
        server.serve_tcp(listener, line)
        return listener.address
    pty = Pty(folder / plug.name.replace(" ", ""))
    server.serve_pty(pty, line())
    return f"serial://{pty.path}?baud={_BAUD}"


@contextmanager
def served(name: str, wires: int, seed: int) -> Iterator[tuple[list[str], Counter[str]]]:
    """Addresses of the wires; what struck is counted when the block is left."""
    struck: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="loftscan-questions-") as folder:
        words = ["--serve", name, "--wires", str(wires), "--seed", str(seed), "--folder", folder]
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.campaigns.questions", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=REPOSITORY,
            start_new_session=True,
        )
        with process:
            assert process.stdin is not None
            assert process.stdout is not None
            yield json.loads(process.stdout.readline()), struck
            process.stdin.close()
            struck.update(json.loads(process.stdout.readline()))
            process.wait(_START_S)


# --- the asking end ------------------------------------------------------------------------------


def ask_much(name: str, address: str, questions: int, seed: int) -> Counter[str]:
    """Ask on one wire; count what came of it."""
    protocol, came = PROTOCOLS[name], Counter[str]()
    dice = random.Random(f"{seed} {address[-1]}")
    link = open_link(address)
    ask = protocol.asking(link)
    for _ in range(questions):
        try:
            came["right" if ask(dice) else "wrong"] += 1
        except DriverError as error:
            came["error"] += 1
            # A stream that was cut amid a message is out of step until somebody connects again.
            if isinstance(error, LinkLost) or protocol.carrier is Carrier.TCP:
                link.close()
                link = open_link(address)
                ask = protocol.asking(link)
    link.close()
    return came


def campaign(
    name: str, *, questions: int, wires: int, seed: int
) -> tuple[Counter[str], Counter[str]]:
    """Deal the questions out; what came of them, and what struck."""
    with served(name, wires, seed) as (addresses, struck), ThreadPoolExecutor(wires) as pool:
        each = questions // wires
        parts = pool.map(lambda address: ask_much(name, address, each, seed), addresses)
        came = sum(parts, Counter[str]())
    return came, struck


def main(words: Sequence[str] | None = None) -> int:
    """Run it; 1 when a bound was broken."""
    parser = argparse.ArgumentParser(prog="questions", description=__doc__.partition("\n")[0])
    parser.add_argument("--questions", type=int, default=10_000, help="in each protocol")
    parser.add_argument("--protocols", default=",".join(PROTOCOLS), help="only these, a comma list")
    parser.add_argument("--wires", type=int, default=8, help="at a time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--serve", choices=PROTOCOLS, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    wanted = parser.parse_args(words)
    if wanted.serve:
        serve(wanted.serve, wanted.wires, wanted.seed, wanted.folder)
        return 0
    broken = 0
    for name in wanted.protocols.split(","):
        begun_s = time.monotonic()
        came, struck = campaign(
            name, questions=wanted.questions, wires=wanted.wires, seed=wanted.seed
        )
        bad = came["wrong"] > 0 or came["right"] < _LEAST_RIGHT * came.total()
        broken += bad
        sys.stdout.write(
            f"{name:6} {came.total()} questions: {came['right']} right, {came['error']} honest"
            f" errors, {came['wrong']} wrong; {time.monotonic() - begun_s:.0f} s, load"
            f" {os.getloadavg()[0]:.1f}; struck: "
            + ", ".join(f"{fault} {count}" for fault, count in sorted(struck.items()))
            + "\n"
        )
        sys.stdout.flush()
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
