"""Wires of loopback, with the drivers' own links at the other end."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TypeVar

import pytest

from drivers.errors import LinkLost, PortBusy
from drivers.links import open_link
from sim.wires import HungUp, Pty, TcpListener, TcpWire, UdpSender

Answer = TypeVar("Answer")

PATIENCE_S = 10.0  # a deadline that only a broken wire reaches
# Every byte that a cooked terminal would eat, echo or turn into a signal.
COOKABLE = bytes.fromhex("0361620d0411137f0a") + bytes(range(256))


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[Pty]:
    with closing(Pty(tmp_path / "table")) as port:
        yield port


@pytest.fixture
def connection() -> Iterator[tuple[TcpWire, socket.socket]]:
    with closing(TcpListener()) as listener, closing(connected(listener)) as peer:
        wire = soon(listener.accept)
        assert wire is not None
        with closing(wire):
            yield wire, peer


def connected(listener: TcpListener) -> socket.socket:
    host, port = listener.address.removeprefix("tcp://").split(":")
    return socket.create_connection((host, int(port)), timeout=PATIENCE_S)


def soon(ask: Callable[[], Answer]) -> Answer:
    """Ask until the answer is not empty."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (answer := ask()):
        assert time.monotonic() < deadline_s, "nothing came"
        time.sleep(0.001)
    return answer


def heard(wire: Pty | TcpWire, size: int) -> bytes:
    data = b""
    while len(data) < size:
        data += soon(wire.read)
    return data


def test_a_serial_port_carries_every_byte_both_ways_and_echoes_none(pty: Pty) -> None:
    with closing(open_link(f"serial://{pty.path}")) as link:
        link.write(COOKABLE)
        assert heard(pty, len(COOKABLE)) == COOKABLE
        assert pty.read() == b""
        assert pty.write(COOKABLE) == len(COOKABLE)
        data = b""
        while len(data) < len(COOKABLE):
            data += link.read(PATIENCE_S)
        assert data == COOKABLE


def test_a_serial_port_that_nobody_opened_is_unattended_and_hung_up(pty: Pty) -> None:
    assert not pty.attended()
    with pytest.raises(HungUp):
        pty.read()
    with pytest.raises(HungUp):
        pty.write(b"lost")


def test_what_was_said_just_before_closing_is_still_heard(pty: Pty) -> None:
    with closing(open_link(f"serial://{pty.path}")) as link:
        link.write(b"laser off")
    assert pty.attended()
    assert heard(pty, 9) == b"laser off"
    with pytest.raises(HungUp):
        pty.read()
    assert not pty.attended()


def test_a_serial_port_is_opened_again_and_again(pty: Pty) -> None:
    for number in (b"0", b"1", b"2"):
        with closing(open_link(f"serial://{pty.path}")) as link:
            assert pty.attended()
            link.write(number)
            assert heard(pty, 1) == number
            assert pty.write(b"yes") == 3
            assert link.read(PATIENCE_S) == b"yes"
        pty.renew()


def test_only_who_opened_a_serial_port_holds_it(pty: Pty) -> None:
    with closing(open_link(f"serial://{pty.path}")):
        with pytest.raises(PortBusy, match=f"process {os.getpid()} ") as refused:
            open_link(f"serial://{pty.path}")
        assert str(refused.value).count("process ") == 1


def test_renewing_a_port_that_can_be_opened_changes_nothing(pty: Pty) -> None:
    before = pty.path.readlink()
    pty.renew()
    assert pty.path.readlink() == before
    with closing(open_link(f"serial://{pty.path}")) as link:
        pty.renew()
        assert pty.path.readlink() == before
        link.write(b"x")
        assert heard(pty, 1) == b"x"


# Whoever has privileges opens a port in spite of TIOCEXCL; so this runs as nobody.
KILLED_OWNER = """
import errno, fcntl, os, signal, sys, tempfile, termios
from pathlib import Path
from sim.wires import Pty
if os.geteuid() == 0:
    os.setegid(65534)
    os.seteuid(65534)
with tempfile.TemporaryDirectory() as folder:
    pty = Pty(Path(folder) / "table")
    owner = os.fork()
    if not owner:
        port = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
        fcntl.ioctl(port, termios.TIOCEXCL)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(owner, 0)
    try:
        os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
        sys.exit("the mark of the dead owner did not stay: nothing is tested")
    except OSError as refused:
        assert refused.errno == errno.EBUSY, refused
    pty.renew()
    port = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    assert pty.write(b"welcome") == 7
    assert os.read(port, 100) == b"welcome"
    pty.close()
"""


def test_a_port_can_be_opened_again_after_its_owner_was_killed() -> None:
    command = [sys.executable, "-W", "ignore", "-c", KILLED_OWNER]
    subprocess.run(command, check=True, timeout=60)


def test_a_closed_port_leaves_no_name_behind(tmp_path: Path) -> None:
    pty = Pty(tmp_path / "table")
    pty.close()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(LinkLost, match="no such port"):
        open_link(f"serial://{pty.path}")


def test_who_reads_a_serial_port_learns_that_the_station_went_off(tmp_path: Path) -> None:
    pty = Pty(tmp_path / "stage")
    with closing(open_link(f"serial://{pty.path}")) as link:
        pty.close()
        with pytest.raises(LinkLost):
            link.read(PATIENCE_S)


def test_a_full_wire_takes_what_it_can_and_does_not_wait(
    pty: Pty, connection: tuple[TcpWire, socket.socket]
) -> None:
    with closing(open_link(f"serial://{pty.path}")):
        for wire in (pty, connection[0]):
            taken = [wire.write(bytes(1 << 20)) for _ in range(100)]
            assert sum(taken) > 0
            assert taken[-1] == 0


def test_a_connection_carries_every_byte_both_ways(
    connection: tuple[TcpWire, socket.socket],
) -> None:
    wire, peer = connection
    peer.sendall(COOKABLE)
    assert heard(wire, len(COOKABLE)) == COOKABLE
    assert wire.read() == b""
    assert wire.write(COOKABLE) == len(COOKABLE)
    assert peer.recv(len(COOKABLE), socket.MSG_WAITALL) == COOKABLE


def test_a_connection_does_not_gather_what_it_sends(
    connection: tuple[TcpWire, socket.socket],
) -> None:
    with socket.socket(fileno=os.dup(connection[0].fileno())) as same:
        assert same.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


@pytest.mark.parametrize("reset", [False, True])
def test_a_connection_that_the_peer_leaves_is_hung_up(
    connection: tuple[TcpWire, socket.socket],
    reset: bool,  # noqa: FBT001 (a case, not an option)
) -> None:
    wire, peer = connection
    peer.sendall(b"last")
    assert heard(wire, 4) == b"last"
    if reset:  # lingering for 0 s sends RST
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, bytes([1] + [0] * 7))
    peer.close()
    with pytest.raises(HungUp):
        soon(wire.read)


def test_listeners_take_ports_of_their_own_and_several_connections_each() -> None:
    with closing(TcpListener()) as one, closing(TcpListener()) as two:
        assert one.address != two.address
        with closing(connected(one)), closing(connected(one)):
            wires = [soon(one.accept), soon(one.accept)]
            assert two.accept() is None
            for wire in wires:
                assert wire is not None
                wire.close()


def test_a_port_that_is_taken_is_refused_and_one_that_is_told_is_used() -> None:
    with closing(TcpListener()) as listener:
        port = int(listener.address.rpartition(":")[2])
        with pytest.raises(OSError, match="in use"):
            TcpListener(port)
    with closing(TcpListener(port)) as again:
        assert again.address == listener.address


def test_datagrams_arrive_whole_and_in_order_at_the_address_that_is_told() -> None:
    with closing(UdpSender()) as sender, closing(open_link(sender.address)) as link:
        for datagram in (b"one", bytes(1400), b"three"):
            sender.send(datagram)
        assert [len(link.read(PATIENCE_S)) for _ in range(3)] == [3, 1400, 5]


def test_datagrams_that_nobody_listens_to_are_lost_without_a_word() -> None:
    with closing(UdpSender()) as sender:
        for _ in range(3):
            sender.send(b"lost")
        with closing(open_link(sender.address)) as link:
            sender.send(b"heard")
            assert link.read(PATIENCE_S) == b"heard"


def test_the_port_of_datagrams_is_kept_from_others_before_anybody_listens() -> None:
    with (
        closing(UdpSender()) as sender,
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other,
        pytest.raises(OSError, match="in use"),
    ):
        other.bind(("", int(sender.address.rpartition(":")[2])))
