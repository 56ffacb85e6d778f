"""A bad wire before a real device: the command, its near end, and what it says at its end."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from drivers.links import open_link
from sim.wires import HungUp, Pty

PATIENCE_S = 20.0


@contextmanager
def proxy(address: str, faults: str = "") -> Iterator[tuple[str, list[str]]]:
    """Its near address, and the lines that it says until it has ended."""
    words = [sys.executable, "-m", "sim.wire_proxy", address, "--faults", faults]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said: list[str] = []
        try:
            yield process.stdout.readline().removeprefix("wire: ").strip(), said
        finally:
            process.send_signal(signal.SIGINT)
            said += process.stdout.read().splitlines()
            process.wait(PATIENCE_S)


@pytest.fixture
def shouting() -> Iterator[str]:
    """A TCP device that answers in capitals."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer(connection: socket.socket) -> None:
            with connection:
                while data := connection.recv(4096):
                    connection.sendall(data.upper())

        def serve() -> None:
            while True:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return
                threading.Thread(target=answer, args=(connection,), daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        listener.shutdown(socket.SHUT_RDWR)


def answered(address: str, words: bytes, size: int) -> bytes:
    with closing(open_link(address)) as link:
        link.write(words)
        heard = b""
        while len(heard) < size and (more := link.read(PATIENCE_S)):
            heard += more
        return heard


def test_a_tcp_device_is_reached_through_it(shouting):
    with proxy(shouting) as (near, said):
        assert near != shouting
        assert answered(near, b"who is there", 12) == b"WHO IS THERE"
    assert said == ["struck: nothing"]


def test_what_it_did_to_the_messages_is_said_at_its_end(shouting):
    with proxy(shouting, "twice=1") as (near, said):
        assert answered(near, b"ab", 8) == b"ABABABAB"  # doubled there, and each answer again
    assert said == ["struck: twice 3"] or said == ["struck: twice 2"]  # answers may come as one


def test_a_serial_device_is_reached_through_it_and_bent_bits_arrive(tmp_path):
    with closing(Pty(tmp_path / "device")) as device:
        ending = threading.Event()

        def shout() -> None:
            while not ending.wait(0.002):
                try:
                    if device.attended() and (data := device.read()):
                        device.write(data.upper())
                except HungUp:
                    continue

        thread = threading.Thread(target=shout)
        thread.start()
        try:
            with proxy(f"serial://{device.path}?baud=115200", "flip=1") as (near, said):
                assert near.endswith("?baud=115200")
                heard = answered(near, b"hear me", 7)
        finally:
            ending.set()
            thread.join()
    assert len(heard) == 7
    assert heard != b"HEAR ME"
    assert said == ["struck: flip 2"]  # there and back


def test_datagrams_are_passed_on():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with (
        proxy(f"udp://127.0.0.1:{port}") as (near, _),
        closing(open_link(near)) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor,
    ):
        sensor.sendto(b"profile", ("127.0.0.1", port))
        assert link.read(PATIENCE_S) == b"profile"


@pytest.mark.parametrize(
    ("address", "code", "said"),
    [
        ("http://station", 2, "no address of a wire"),
        ("tcp://127.0.0.1:1", 4, "no connection"),
        ("serial:///nowhere/at/all", 4, "nowhere"),
    ],
)
def test_what_cannot_be_reached_is_one_line(address, code, said):
    ran = subprocess.run(
        [sys.executable, "-m", "sim.wire_proxy", address],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert ran.returncode == code
    assert ran.stderr.count("\n") == 1
    assert said in ran.stderr


def test_an_impossible_fault_is_one_line():
    ran = subprocess.run(
        [sys.executable, "-m", "sim.wire_proxy", "tcp://127.0.0.1:1", "--faults", "late=7"],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert (ran.returncode, ran.stderr) == (
        2,
        "wire: fault 'late=7': give a chance from 0 to 1 after the =\n",
    )
