"""Links by address: what is opened, what passes, who holds a port, and how each is lost."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import repeat
from pathlib import Path

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.addresses import Dtr, SerialAddress, TcpAddress, UdpAddress, parse_address
from drivers.errors import LinkLost, PortBusy
from drivers.holders import Holder, holders_of
from drivers.links import ByteLink, open_link
from drivers.loopback import Carrying, loopback
from drivers.serial_link import SerialLink
from drivers.udp_link import UdpLink

repeatable = settings(deadline=None, derandomize=True)
PATIENCE_S = 10.0  # a deadline that only a broken link reaches
# Every byte that a cooked terminal would eat, echo or turn into a signal (reliability.md 0.9).
COOKABLE = bytes.fromhex("0361620d0411137f0a") + bytes(range(256))


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """The master's descriptor and the slave's address."""
    master, slave = os.openpty()
    address = f"serial://{os.ttyname(slave)}"
    os.close(slave)
    yield master, address
    with suppress(OSError):  # the test may have unplugged it
        os.close(master)


def read_all(link: ByteLink, size: int) -> bytes:
    data = b""
    while len(data) < size:
        came = link.read(PATIENCE_S)
        assert came, f"only {len(data)} of {size} bytes in {PATIENCE_S} s"
        data += came
    return data


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("serial:///dev/ttyUSB0", SerialAddress("", "/dev/ttyUSB0", 115200, "N", 1, Dtr.HIGH)),
        (
            "serial:///dev/serial/by-id/usb-x?baud=9600&parity=E&stop=2&dtr=held",
            SerialAddress("", "/dev/serial/by-id/usb-x", 9600, "E", 2, Dtr.HELD),
        ),
        ("tcp://192.168.0.10:502", TcpAddress("", "192.168.0.10", 502)),
        ("tcp://[::1]:502", TcpAddress("", "::1", 502)),
        ("udp://:9009", UdpAddress("", "", 9009)),
        ("udp://10.0.0.1:0?peer=10.0.0.2:9008", UdpAddress("", "10.0.0.1", 0, ("10.0.0.2", 9008))),
    ],
)
def test_an_address_says_what_is_opened(text: str, value: object) -> None:
    parsed = parse_address(text)
    assert parsed.text == text
    assert parsed == type(parsed)(text, *_fields(value)[1:])


def _fields(value: object) -> list[object]:
    return [getattr(value, name) for name in value.__slots__]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("/dev/ttyUSB0", "expected serial:///dev/ttyUSB0"),
        ("http://host:80", "expected serial:///dev/ttyUSB0.*tcp://host:port.*udp://:port"),
        ("serial://ttyUSB0", "three slashes"),
        ("serial:///", "three slashes"),
        ("serial:///dev/ttyUSB0?baud=fast", "baud 'fast' is no whole number"),
        ("serial:///dev/ttyUSB0?baud=0", "baud"),
        ("serial:///dev/ttyUSB0?parity=EN", "parity 'EN' is none of N, E, O"),
        ("serial:///dev/ttyUSB0?stop=3", "stop"),
        ("serial:///dev/ttyUSB0?dtr=up", "'up' is not a valid Dtr"),
        ("serial:///dev/ttyUSB0?speed=9600", "no option 'speed'"),
        ("serial:///dev/ttyUSB0?baud=9600&baud=19200", "twice"),
        ("serial:///dev/ttyUSB0?baud", "expected serial"),
        ("tcp://host", "port is missing.*expected tcp://host:port"),
        ("tcp://:502", "both needed"),
        ("tcp://host:0", "both needed"),
        ("tcp://host:70000", "expected tcp://host:port"),
        ("tcp://host:502/unit", "nothing but host and port"),
        ("tcp://host:502?unit=1", "no option 'unit'"),
        ("udp://", "port is missing"),
        ("udp://:9009?peer=host", "port is missing"),
        ("udp://:9009?pear=host:1", "no option 'pear'"),
        ("udp://:9009?peer=:9008", "the peer needs"),
    ],
)
def test_a_bad_address_says_what_was_expected(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as mistake:
        open_link(text)
    assert repr(text) in str(mistake.value)


@repeatable
@given(st.text("atl:/?&=@[]#%.0519é\n", max_size=12))
def test_any_text_is_an_address_or_a_value_error(text: str) -> None:
    for scheme in ("", "serial://", "tcp://", "udp://"):
        with suppress(ValueError):
            assert parse_address(scheme + text).text == scheme + text


def test_a_serial_link_is_raw_both_ways(pty: tuple[int, str]) -> None:
    master, address = pty
    link = open_link(address)
    assert link.address == address
    os.write(master, COOKABLE)
    assert read_all(link, len(COOKABLE)) == COOKABLE
    link.write(COOKABLE)
    came = b""
    while len(came) < len(COOKABLE):
        came += os.read(master, 4096)
    assert came == COOKABLE
    assert link.read(0.0) == b""
    link.close()


def test_a_serial_read_returns_all_that_has_arrived(pty: tuple[int, str]) -> None:
    master, address = pty
    link = open_link(address)
    assert isinstance(link, SerialLink)
    os.write(master, b"<Idle>")
    give_up_s = time.monotonic() + PATIENCE_S
    while link._port.in_waiting < 6 and time.monotonic() < give_up_s:
        time.sleep(0.001)
    assert link.read(0.0) == b"<Idle>"
    link.close()


def test_a_port_that_we_hold_is_busy_and_the_holder_is_named(pty: tuple[int, str]) -> None:
    _, address = pty
    holder = open_link(address)
    with pytest.raises(PortBusy, match=f"held by process {os.getpid()} ") as busy:
        open_link(address)
    assert address in str(busy.value)
    holder.close()
    open_link(address).close()


def test_a_port_that_another_process_holds_is_busy_until_it_ends(pty: tuple[int, str]) -> None:
    _, address = pty
    script = (
        "import sys; from drivers.links import open_link; link = open_link(sys.argv[1]);"
        "print('held', flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", script, address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=Path(__file__).resolve().parents[2],
    )
    with other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(PortBusy, match=rf"process {other.pid} \(.*python.* -c "):
            open_link(address)
    open_link(address).close()


def test_the_kernel_keeps_out_who_does_not_ask_while_the_link_is_open(pty: tuple[int, str]) -> None:
    _, address = pty
    link = open_link(address)
    other = os.open(address.removeprefix("serial://"), os.O_RDWR | os.O_NOCTTY) if root() else None
    assert exclusive(link.fileno())  # type: ignore[attr-defined]
    link.close()
    if other is not None:  # root is let in, and sees the mark taken off
        assert not exclusive(other)
        os.close(other)


def root() -> bool:
    return os.geteuid() == 0


def exclusive(descriptor: int) -> bool:
    """Linux's TIOCGEXCL."""
    import array
    import fcntl

    answer = array.array("i", [0])
    fcntl.ioctl(descriptor, 0x80045440, answer)
    return bool(answer[0])


def test_dtr_is_dropped_on_close_unless_it_is_held(pty: tuple[int, str]) -> None:
    for dtr in (Dtr.HIGH, Dtr.HELD, Dtr.LOW, Dtr.HELD):  # whatever the last user left behind
        link = open_link(f"{pty[1]}?dtr={dtr.value}")
        assert isinstance(link, SerialLink)
        hangs_up = bool(termios.tcgetattr(link.fileno())[2] & termios.HUPCL)
        assert hangs_up is (dtr is not Dtr.HELD)
        assert link._port.dtr is (dtr is not Dtr.LOW)
        link.close()


def test_an_unplugged_port_is_lost_on_read_and_on_every_later_call(pty: tuple[int, str]) -> None:
    master, address = pty
    link = open_link(address)
    os.close(master)
    with pytest.raises(LinkLost, match="is the cable in"):
        link.read(PATIENCE_S)
    with pytest.raises(LinkLost, match="is the cable in"):
        link.write(b"?")
    link.close()
    link.close()


def test_an_unplugged_port_is_lost_on_write(pty: tuple[int, str]) -> None:
    master, address = pty
    link = open_link(address)
    os.close(master)
    with pytest.raises(LinkLost, match="is the cable in"):
        link.write(b"?")
    link.close()


@pytest.mark.parametrize(
    "failure",
    [
        serial.SerialException("device reports readiness to read but returned no data"),
        serial.SerialException(5, "write failed"),
        OSError(5, "Input/output error"),
        termios.error(5, "Input/output error"),
    ],
)
def test_each_exception_of_an_unplug_is_a_lost_link(pty, monkeypatch, failure) -> None:
    # reliability.md 0.8: one unplug shows as these four.
    class Gone:
        write_timeout = 1.0

        def fileno(self) -> int:
            raise failure

        def write(self, _: bytes) -> None:
            raise failure

        def close(self) -> None:
            raise failure

    for act in (lambda link: link.read(0.0), lambda link: link.write(b"?")):
        link = open_link(pty[1])
        assert isinstance(link, SerialLink)
        real = link._port
        monkeypatch.setattr(link, "_port", Gone())
        with pytest.raises(LinkLost) as lost:
            act(link)
        assert lost.value.__cause__ is failure
        link.close()
        real.close()


def test_a_device_that_takes_no_bytes_is_lost_within_the_links_own_deadline(pty) -> None:
    link = SerialLink(SerialAddress(pty[1], pty[1].removeprefix("serial://")), write_s=0.05)
    with pytest.raises(LinkLost, match=r"takes no bytes in 0.05 s"):
        link.write(bytes(1_000_000))
    link.close()


def test_a_port_that_is_not_there_is_lost_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(LinkLost, match="no such port; is the cable in"):
        open_link(f"serial://{tmp_path}/ttyUSB7")
    (tmp_path / "file").touch()
    with pytest.raises(LinkLost, match="is it a serial port"):
        open_link(f"serial://{tmp_path}/file")


def test_holders_are_found_where_proc_may_be_read(tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0"
    device.touch()
    for pid, command in ((20, b"minicom\0-D\0x"), (3, b"")):
        (tmp_path / str(pid) / "fd").mkdir(parents=True)
        (tmp_path / str(pid) / "fd" / "5").symlink_to(device)
        (tmp_path / str(pid) / "cmdline").write_bytes(command)
    (tmp_path / "4").mkdir()  # ended meanwhile
    (tmp_path / "by-id").symlink_to(device)
    found = holders_of(str(tmp_path / "by-id"), processes=tmp_path)
    assert found == (Holder(3, "name unknown"), Holder(20, "minicom -D x"))


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(PATIENCE_S)
        yield listening


def test_a_tcp_link_passes_bytes_and_is_lost_when_the_peer_closes(listener) -> None:
    link = open_link(f"tcp://127.0.0.1:{listener.getsockname()[1]}")
    peer, _ = listener.accept()
    with peer:
        assert link.read(0.0) == b""
        peer.sendall(COOKABLE)
        assert read_all(link, len(COOKABLE)) == COOKABLE
        link.write(b"request")
        assert peer.recv(100) == b"request"
        peer.sendall(b"last words")
    assert read_all(link, 10) == b"last words"
    for _ in range(2):
        with pytest.raises(LinkLost, match="the peer closed"):
            link.read(PATIENCE_S)
    with pytest.raises(LinkLost, match="the peer closed"):
        link.write(b"?")
    link.close()


def test_a_tcp_link_does_not_delay_and_keeps_alive(listener) -> None:
    link = open_link(f"tcp://127.0.0.1:{listener.getsockname()[1]}")
    twin = socket.socket(fileno=os.dup(link.fileno()))  # type: ignore[attr-defined]
    with twin:
        assert twin.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert twin.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        assert twin.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 5
    link.close()
    with pytest.raises(LinkLost, match="was closed"):
        link.read(0.0)


def test_a_peer_that_does_not_listen_is_lost_with_a_remedy(listener) -> None:
    port = listener.getsockname()[1]
    listener.close()
    with pytest.raises(LinkLost, match=f"tcp://127.0.0.1:{port}: no connection.*is the device on"):
        open_link(f"tcp://127.0.0.1:{port}")


@pytest.fixture
def udp_pair() -> Iterator[tuple[UdpLink, UdpLink]]:
    """A listener, and a device that knows where to send."""
    here = open_link("udp://127.0.0.1:0")
    assert isinstance(here, UdpLink)
    there = open_link(f"udp://127.0.0.1:0?peer=127.0.0.1:{here.port}")
    assert isinstance(there, UdpLink)
    yield here, there
    here.close()
    there.close()


def test_a_udp_read_is_one_datagram_whatever_its_size(udp_pair) -> None:
    here, there = udp_pair
    sizes = [1, 1400, 9000, 65000]
    for size in sizes:
        there.write(bytes(size))
    assert [len(here.read(PATIENCE_S)) for _ in sizes] == sizes
    assert here.read(0.0) == b""


def test_a_udp_link_answers_whoever_sent_last(udp_pair) -> None:
    here, there = udp_pair
    with pytest.raises(LinkLost, match=r"nobody has sent yet.*\?peer=host:port"):
        here.write(b"who?")
    with open_socket() as stranger:
        stranger.sendto(b"me", ("127.0.0.1", here.port))
        assert here.read(PATIENCE_S) == b"me"
        here.write(b"you")
        assert stranger.recv(10) == b"you"
        there.write(b"now me")
        assert here.read(PATIENCE_S) == b"now me"
        here.write(b"you")
        assert there.read(PATIENCE_S) == b"you"
        stranger.sendto(b"x", ("127.0.0.1", there.port))
        assert there.read(PATIENCE_S) == b"x"
        there.write(b"still to its peer")
        assert here.read(PATIENCE_S) == b"still to its peer"


def open_socket() -> socket.socket:
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stranger.bind(("127.0.0.1", 0))
    stranger.settimeout(PATIENCE_S)
    return stranger


def test_a_udp_link_asks_for_a_buffer_and_says_what_it_got(udp_pair) -> None:
    with open_socket() as plain:
        usual = plain.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    assert udp_pair[0].receive_buffer_bytes > usual


def test_a_udp_port_that_is_taken_or_closed_is_a_lost_link(udp_pair) -> None:
    here, _ = udp_pair
    with pytest.raises(LinkLost, match="is another program listening"):
        open_link(f"udp://127.0.0.1:{here.port}")
    here.close()
    with pytest.raises(LinkLost, match="was closed"):
        here.read(0.0)


@repeatable
@given(st.lists(st.binary(max_size=20), max_size=10), st.lists(st.integers(1, 9), min_size=1))
def test_a_loopback_keeps_every_byte_however_it_dribbles(writes, sizes) -> None:
    near, far = loopback(dribble=iter(sizes * 200), wait=lambda _: None)
    for data in writes:
        near.write(data)
    near.close()
    chunks = []
    while sum(map(len, chunks)) < sum(map(len, writes)):
        chunks.append(far.read(0.0))
    assert b"".join(chunks) == b"".join(writes)
    assert all(len(chunk) <= most for chunk, most in zip(chunks, sizes * 200, strict=False))
    with pytest.raises(LinkLost, match="loopback:far: the other end closed"):
        far.read(0.0)


def test_a_loopback_of_datagrams_keeps_them_apart() -> None:
    near, far = loopback("ox", carrying=Carrying.DATAGRAMS, wait=lambda _: None)
    near.write(b"one")
    near.write(b"two")
    assert [far.read(0.0) for _ in range(3)] == [b"one", b"two", b""]
    with pytest.raises(ValueError, match="whole"):
        loopback(carrying=Carrying.DATAGRAMS, dribble=repeat(1))


def test_a_loopback_wakes_the_thread_that_waits() -> None:
    near, far = loopback()
    device = threading.Thread(target=lambda: far.write(far.read(PATIENCE_S).upper()))
    started_s = time.monotonic()
    device.start()
    near.write(b"ok")
    assert near.read(PATIENCE_S) == b"OK"
    assert time.monotonic() - started_s < PATIENCE_S / 2  # woken, not timed out
    device.join(PATIENCE_S)
    assert near.read(0.0) == b""
    far.close()
    with pytest.raises(LinkLost):
        near.write(b"?")
    near.close()
    with pytest.raises(LinkLost, match="near: the link was closed"):
        near.read(0.0)


def test_a_loopback_with_a_wait_needs_no_thread() -> None:
    waited = []
    near, far = loopback(wait=lambda seconds: (waited.append(seconds), far.write(b"!")))
    assert near.read(0.25) == b"!"
    assert waited == [0.25]
