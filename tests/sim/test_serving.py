"""The server over real wires, with toys for devices; each turn of it is the test's own."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import pytest

from drivers.errors import LinkLost
from drivers.links import ByteLink, open_link
from sim.serving import Ending, Server
from sim.wires import Pty, TcpListener, UdpSender

PATIENCE_S = 10.0  # a deadline that only a broken server reaches


class Parrot:
    """Answers in capitals; says what it was told to at a tick."""

    def __init__(self) -> None:
        self.heard = b""
        self.ticks: list[float] = []
        self.unasked = b""
        self.lost = False

    def receive(self, data: bytes, now_s: float) -> bytes:
        del now_s
        self.heard += data
        self.lost = b"!" in data
        return data.upper()

    def tick(self, now_s: float) -> bytes:
        self.ticks.append(now_s)
        said, self.unasked = self.unasked, b""
        return said


class Counter:
    """Sends a number at each call."""

    def __init__(self) -> None:
        self.sent = 0

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        del now_s
        self.sent += 1
        return [b"%d" % self.sent, b"."]


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as running:
        yield running


def turning(server: Server, until: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not until():
        assert time.monotonic() < deadline_s, "it never came to pass"
        server.turn()


def heard(server: Server, link: ByteLink, size: int) -> bytes:
    data = b""

    def listen() -> bool:
        nonlocal data
        data += link.read(0.0)
        return len(data) >= size

    turning(server, listen)
    return data


def seconds_of_turns(server: Server, turns: int) -> list[float]:
    took_s = []
    for _ in range(turns):
        begun_s = time.monotonic()
        server.turn()
        took_s.append(time.monotonic() - begun_s)
    return took_s


def test_a_device_answers_on_its_serial_port_to_one_owner_after_the_other(
    server: Server, tmp_path: Path
) -> None:
    server.serve_pty(Pty(tmp_path / "table"), Parrot())
    for words in (b"one", b"two", b"three"):
        with closing(open_link(f"serial://{tmp_path / 'table'}")) as link:
            link.write(words)
            assert heard(server, link, len(words)) == words.upper()


def test_what_an_owner_said_before_it_closed_is_heard_and_not_answered_to_the_next(
    server: Server, tmp_path: Path
) -> None:
    parrot = Parrot()
    server.serve_pty(Pty(tmp_path / "table"), parrot)
    with closing(open_link(f"serial://{tmp_path / 'table'}")) as link:
        link.write(b"laser off")
    turning(server, lambda: parrot.heard == b"laser off")
    with closing(open_link(f"serial://{tmp_path / 'table'}")) as link:
        link.write(b"hello")
        assert heard(server, link, 5) == b"HELLO"


def test_every_connection_has_a_session_of_its_own(server: Server) -> None:
    sessions: list[Parrot] = []

    def session() -> Parrot:
        sessions.append(Parrot())
        return sessions[-1]

    listener = TcpListener()
    server.serve_tcp(listener, session)
    with (
        closing(open_link(listener.address)) as one,
        closing(open_link(listener.address)) as two,
    ):
        one.write(b"first")
        two.write(b"second")
        assert heard(server, two, 6) == b"SECOND"
        assert heard(server, one, 5) == b"FIRST"
    assert sorted(each.heard for each in sessions) == [b"first", b"second"]


def test_devices_are_told_the_time_whether_or_not_somebody_is_there(
    server: Server, tmp_path: Path
) -> None:
    alone, attended, watchdog = Parrot(), Parrot(), Parrot()
    server.serve_pty(Pty(tmp_path / "alone"), alone)
    server.serve_pty(Pty(tmp_path / "attended"), attended)
    server.tell_time(watchdog.tick)
    with closing(open_link(f"serial://{tmp_path / 'attended'}")) as link:
        attended.unasked = alone.unasked = b"Grbl 1.1h"
        assert heard(server, link, 9) == b"Grbl 1.1h"
        for each in (alone, attended, watchdog):
            before = len(each.ticks)
            for _ in range(5):
                server.turn()
            assert len(each.ticks) == before + 5
            assert each.ticks == sorted(each.ticks)


def test_what_is_said_unasked_to_nobody_is_lost(server: Server, tmp_path: Path) -> None:
    parrot = Parrot()
    server.serve_pty(Pty(tmp_path / "table"), parrot)
    parrot.unasked = b"stale"
    server.turn()
    assert parrot.unasked == b""
    with closing(open_link(f"serial://{tmp_path / 'table'}")) as link:
        link.write(b"x")
        assert heard(server, link, 1) == b"X"


def test_profiles_are_sent_as_they_come(server: Server) -> None:
    sender = UdpSender()
    server.broadcast(sender, Counter())
    with closing(open_link(sender.address)) as link:
        server.turn()
        server.turn()
        assert [link.read(PATIENCE_S) for _ in range(4)] == [b"1", b".", b"2", b"."]


def test_a_session_that_lost_the_thread_is_closed(server: Server) -> None:
    listener = TcpListener()
    server.serve_tcp(listener, Parrot)
    with closing(open_link(listener.address)) as link:
        link.write(b"fine")
        assert heard(server, link, 4) == b"FINE"
        link.write(b"!")
        with pytest.raises(LinkLost):
            heard(server, link, 100)


def test_who_does_not_read_delays_nobody_and_gets_all_when_he_does(
    server: Server, tmp_path: Path
) -> None:
    talker, listener = Parrot(), TcpListener()
    server.serve_tcp(listener, lambda: talker)
    server.serve_pty(Pty(tmp_path / "table"), Parrot())
    with (
        closing(small_socket(listener)) as slow,
        closing(open_link(f"serial://{tmp_path / 'table'}")) as link,
    ):
        turning(server, lambda: talker.ticks)
        speech = b"".join(b"%07d\n" % line for line in range(20_000))
        talker.unasked = speech
        link.write(b"and me?")
        assert heard(server, link, 7) == b"AND ME?"
        data = bytearray()

        def listen() -> bool:
            try:
                data.extend(slow.recv(65536))
            except BlockingIOError:
                return False
            return len(data) >= len(speech)

        turning(server, listen)
        assert data == speech


def small_socket(listener: TcpListener) -> socket.socket:
    """A peer with little room, so that what is said to it stays with the server."""
    host, port = listener.address.removeprefix("tcp://").split(":")
    peer = socket.socket()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    peer.connect((host, int(port)))
    peer.settimeout(0.0)
    return peer


def test_who_never_reads_is_left_before_memory_fills(server: Server) -> None:
    talker, listener = Parrot(), TcpListener()
    server.serve_tcp(listener, lambda: talker)
    with closing(small_socket(listener)) as deaf:
        turning(server, lambda: talker.ticks)
        talker.unasked = bytes(16 << 20)
        turning(server, lambda: not talker.unasked)
        before = len(talker.ticks)
        server.turn()
        assert len(talker.ticks) == before
        deaf.settimeout(PATIENCE_S)
        with pytest.raises(ConnectionResetError):  # or it would have come to the end of it
            read_to_the_end(deaf, 16 << 20)


def read_to_the_end(peer: socket.socket, size: int) -> None:
    while size > 0:
        data = peer.recv(65536)
        if not data:
            raise ConnectionResetError
        size -= len(data)


def test_at_rest_it_sleeps_though_ports_were_left_and_wires_are_open(
    server: Server, tmp_path: Path
) -> None:
    parrot, listener = Parrot(), TcpListener()
    server.serve_pty(Pty(tmp_path / "left"), parrot)
    server.serve_pty(Pty(tmp_path / "open"), Parrot())
    server.serve_tcp(listener, Parrot)
    with closing(open_link(f"serial://{tmp_path / 'left'}")) as link:
        link.write(b"x")
        assert heard(server, link, 1) == b"X"
    with (
        closing(open_link(f"serial://{tmp_path / 'open'}")),
        closing(open_link(listener.address)),
    ):
        seconds_of_turns(server, 30)  # after the last byte it stays awake for a moment
        assert sum(seconds_of_turns(server, 20)) > 0.15


def test_while_the_station_is_lively_it_is_awake_every_few_ms() -> None:
    with Server(lively=lambda _: True) as server:
        assert min(seconds_of_turns(server, 50)) < 0.006


def test_it_ends_when_asked_to_and_when_a_pipe_is_closed(server: Server) -> None:
    ending = Ending()
    server.tell_time(lambda _: ending.ask())
    server.run(ending)
    assert ending.asked
    reading, writing = os.pipe()
    other = Ending()
    server.end_with(reading, other)
    os.write(writing, b"still here")
    for _ in range(5):
        server.turn()
    assert not other.asked
    os.close(writing)
    server.run(other)
    server.turn()
    os.close(reading)


def test_a_file_cannot_end_it(server: Server, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with (tmp_path / "file").open("rb") as file, pytest.raises(PermissionError):
        server.end_with(file.fileno(), Ending())


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_it_leaves_no_port_open_behind(tmp_path: Path) -> None:
    before = descriptors()
    listener, sender = TcpListener(), UdpSender()
    with Server() as server:
        server.serve_pty(Pty(tmp_path / "table"), Parrot())
        server.serve_tcp(listener, Parrot)
        server.broadcast(sender, Counter())
        link = open_link(listener.address)
        link.write(b"x")
        assert heard(server, link, 1) == b"X"
    with pytest.raises(LinkLost):
        link.read(PATIENCE_S)
    link.close()
    assert list(tmp_path.iterdir()) == []
    assert descriptors() == before
