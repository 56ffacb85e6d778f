"""Where a device is reached, as text and as values: what a station file says and a link opens.

    serial:///dev/ttyUSB0?baud=115200&parity=E&stop=1&dtr=held
    tcp://192.168.0.10:502
    udp://:9009                   bind, answer whoever sent last
    udp://:9009?peer=10.0.0.2:9008

Parsing opens nothing, so a station file can be checked away from the station.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from urllib.parse import SplitResult, parse_qsl, urlsplit

EXPECTED = {
    "serial": "serial:///dev/ttyUSB0?baud=115200&parity=N&stop=1&dtr=high",
    "tcp": "tcp://host:port",
    "udp": "udp://:port, udp://host:port or udp://:port?peer=host:port",
}


class Dtr(Enum):
    """What the DTR line does; many boards reset on its edge."""

    HIGH = "high"  # raised on open, dropped on close
    LOW = "low"  # lowered as soon as the port is open
    HELD = "held"  # raised on open and left so on close: a board resets once, not at each open


@dataclass(frozen=True, slots=True)
class SerialAddress:
    """A serial port and how its line speaks; eight data bits always."""

    text: str
    device: str
    baud: int = 115200
    parity: str = "N"
    stop_bits: int = 1
    dtr: Dtr = Dtr.HIGH


@dataclass(frozen=True, slots=True)
class TcpAddress:
    """A listening peer."""

    text: str
    host: str
    port: int


@dataclass(frozen=True, slots=True)
class UdpAddress:
    """Where datagrams are received, and to whom they go."""

    text: str
    host: str  # empty: every interface
    port: int  # 0: any that is free
    peer: tuple[str, int] | None = None  # None: whoever sent last


def parse_address(text: str) -> SerialAddress | TcpAddress | UdpAddress:
    """Read an address.

    Raises
    ------
    ValueError
        Unknown scheme or option, or a part missing; says what was expected.
    """
    scheme = text.partition("://")[0]
    if scheme not in EXPECTED:
        raise ValueError(f"address {text!r}: expected " + "; ".join(EXPECTED.values()))
    try:
        parts = urlsplit(text)
        return _PARSERS[scheme](text, parts, _options(parts.query))
    except (ValueError, KeyError) as wrong:
        reason = f"no option {wrong.args[0]!r}" if isinstance(wrong, KeyError) else wrong
        raise ValueError(f"address {text!r}: {reason}; expected {EXPECTED[scheme]}") from wrong


def _options(query: str) -> dict[str, str]:
    pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    options = dict(pairs)
    if len(options) != len(pairs):
        raise ValueError("an option is given twice")
    return options


def _serial(text: str, parts: SplitResult, options: Mapping[str, str]) -> SerialAddress:
    if parts.netloc or not parts.path.strip("/"):
        raise ValueError("the device is a path after three slashes")
    _only(options, "baud", "parity", "stop", "dtr")
    return SerialAddress(
        text,
        parts.path,
        baud=_natural(options.get("baud", "115200"), "baud", 50, 4_000_000),
        parity=_one_of(options.get("parity", "N"), "parity", "NEO"),
        stop_bits=int(_one_of(options.get("stop", "1"), "stop", "12")),
        dtr=Dtr(options.get("dtr", "high")),
    )


def _tcp(text: str, parts: SplitResult, options: Mapping[str, str]) -> TcpAddress:
    _only(options)
    host, port = _host_and_port(parts)
    if not host or not port:
        raise ValueError("host and port are both needed")
    return TcpAddress(text, host, port)


def _udp(text: str, parts: SplitResult, options: Mapping[str, str]) -> UdpAddress:
    _only(options, "peer")
    host, port = _host_and_port(parts)
    peer = _host_and_port(urlsplit(f"udp://{options['peer']}")) if "peer" in options else None
    if peer is not None and not all(peer):
        raise ValueError("the peer needs host and port")
    return UdpAddress(text, host, port, peer)


_Parser = Callable[[str, SplitResult, Mapping[str, str]], SerialAddress | TcpAddress | UdpAddress]
_PARSERS: dict[str, _Parser] = {"serial": _serial, "tcp": _tcp, "udp": _udp}


def _host_and_port(parts: SplitResult) -> tuple[str, int]:
    if parts.path.strip("/") or parts.username is not None:
        raise ValueError("nothing but host and port belongs there")
    if parts.port is None:
        raise ValueError("the port is missing")
    return parts.hostname or "", parts.port


def _only(options: Mapping[str, str], *known: str) -> None:
    for name in options:
        if name not in known:
            raise KeyError(name)


def _natural(text: str, name: str, low: int, high: int) -> int:
    if not (text.isascii() and text.isdigit() and low <= int(text) <= high):
        raise ValueError(f"{name} {text!r} is no whole number from {low} to {high}")
    return int(text)


def _one_of(text: str, name: str, known: str) -> str:
    if len(text) != 1 or text not in known:
        raise ValueError(f"{name} {text!r} is none of {', '.join(known)}")
    return text
