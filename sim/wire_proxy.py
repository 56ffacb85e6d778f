"""``python -m sim.wire_proxy ADDRESS --faults late=0.05``: a bad wire before a real device.

For a rehearsal with the station's own hardware, and for tests beside foreign servers: what is
printed goes into station.toml in place of the address that was given::

    loftscan -- serial:///.../wire --> FaultyLine --> Upstream -- serial:///dev/ttyUSB0
    loftscan -- tcp://127.0.0.1:port -> FaultyLine --> Upstream -- tcp://192.168.0.7:502
    loftscan <- udp://127.0.0.2:port -- FaultyNetwork <- Ears <-- udp://0.0.0.0:50001

Ends with Ctrl-C and says then how often each fault struck.
"""

from __future__ import annotations

import argparse
import random
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import serial  # type: ignore[import-untyped]

from sim.faults import parse_faults
from sim.faulty_wire import FaultyLine, FaultyNetwork, Plug
from sim.serving import Ending, Server
from sim.wire_faults import WIRE_FAULTS, Carrier, WireFaults
from sim.wires import Pty, TcpListener, UdpSender

_READ_BYTES = 65536
_CONNECT_S = 3.0
_WRITE_S = 1.0  # a device that takes no bytes for so long counts as lost


class Upstream:
    """A real device behind a connection of ours; a `sim.device.Device` for whoever is served.

    Parameters
    ----------
    read, write
        Neither waits: what has arrived; and send.
    """

    def __init__(self, read: Callable[[], bytes], write: Callable[[bytes], object]) -> None:
        self._read = read
        self._write = write
        self.lost = False

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Pass it on to the device; return what the device has said."""
        if not self.lost:
            try:
                self._write(data)
            except OSError:
                self.lost = True
        return self.tick(now_s)

    def tick(self, now_s: float) -> bytes:
        """What the device has said."""
        del now_s
        try:
            return b"" if self.lost else self._read()
        except BlockingIOError:
            return b""
        except OSError:
            self.lost = True
            return b""


class Ears:
    """Datagrams of a real device, as they come; a `sim.device.Broadcaster`."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        listener.settimeout(0.0)

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        """What has arrived."""
        del now_s
        heard: list[bytes] = []
        try:
            while True:
                heard.append(self._listener.recv(_READ_BYTES))
        except BlockingIOError:
            return heard


def lay(
    address: str, faults: WireFaults, seed: int, server: Server, plug: Plug, folder: Path
) -> str:
    """Lay a bad wire to a device; return the address of its near end.

    Raises
    ------
    ValueError
        No address of a wire.
    OSError
        Nothing is there.
    """
    told, dice = urlsplit(address), random.Random(seed)
    if told.scheme == "serial" and told.path:
        pty = Pty(folder / "wire")
        line = FaultyLine(_serial(address), faults, Carrier.SERIAL, plug, dice)
        server.serve_pty(pty, line)
        return f"serial://{pty.path}" + (f"?{told.query}" if told.query else "")
    if told.scheme == "tcp" and told.hostname and told.port:
        there, listener = (told.hostname, told.port), TcpListener()
        _connection(*there).close()  # refuse now what will not answer later
        server.serve_tcp(
            listener, lambda: FaultyLine(_tcp(*there), faults, Carrier.TCP, plug, dice)
        )
        return listener.address
    if told.scheme == "udp" and told.hostname and told.port:
        ears = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        ears.bind((told.hostname, told.port))
        sender = UdpSender()
        server.broadcast(sender, FaultyNetwork(Ears(ears), faults, plug, dice))
        return sender.address
    raise ValueError(
        f"{address}: no address of a wire; serial:///dev/..., tcp://host:port, udp://host:port are"
    )


def _serial(address: str) -> Upstream:
    told = urlsplit(address)
    wanted = {key: values[-1] for key, values in parse_qs(told.query).items()}
    try:
        port = serial.Serial(
            told.path,
            baudrate=int(wanted.get("baud", "115200")),
            parity=wanted.get("parity", "N"),
            stopbits=int(wanted.get("stop", "1")),
            timeout=0,
            write_timeout=_WRITE_S,
            exclusive=True,
        )
    except ValueError as wrong:
        raise ValueError(f"{address}: {wrong}; write baud=115200, parity=N, stop=1") from wrong
    return Upstream(lambda: bytes(port.read(_READ_BYTES)), port.write)


def _connection(host: str, port: int) -> socket.socket:
    try:
        return socket.create_connection((host, port), timeout=_CONNECT_S)
    except OSError as failure:
        raise OSError(f"tcp://{host}:{port}: no connection ({failure}); is it on?") from failure


def _tcp(host: str, port: int) -> Upstream:
    connection = _connection(host, port)
    connection.settimeout(0.0)

    def read() -> bytes:
        data = connection.recv(_READ_BYTES)
        if not data:
            raise ConnectionResetError
        return data

    return Upstream(read, connection.sendall)


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m sim.wire_proxy",
        description="A bad wire before a real device.",
        epilog="faults: " + "; ".join(f"{name}: {what}" for name, what in WIRE_FAULTS.items()),
    )
    parser.add_argument("address", help="of the device, as station.toml has it")
    parser.add_argument("--faults", default="", metavar="NAME=P,...")
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args(words)
    ending = Ending()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, ending.ask)
    try:
        faults = parse_faults(wanted.faults).wires
        _serve(wanted.address, faults, wanted.seed, ending)
    except ValueError as wrong:
        sys.stderr.write(f"wire: {wrong}\n")
        return 2
    except OSError as failure:
        sys.stderr.write(f"wire: {failure}\n")
        return 4
    return 0


def _serve(address: str, faults: WireFaults, seed: int, ending: Ending) -> None:
    plug = Plug("wire", away_s=faults.away_s)
    with ExitStack() as open_ones:
        folder = open_ones.enter_context(tempfile.TemporaryDirectory(prefix="loftscan-wire-"))
        server = open_ones.enter_context(Server(lively=lambda _: True, clock=time.monotonic))
        near = lay(address, faults, seed, server, plug, Path(folder))
        sys.stdout.write(f"wire: {near}\n")
        sys.stdout.flush()
        server.run(ending)
    struck = ", ".join(f"{name} {count}" for name, count in sorted(plug.happened.items()))
    sys.stdout.write(f"struck: {struck or 'nothing'}\n")


if __name__ == "__main__":
    sys.exit(main())
