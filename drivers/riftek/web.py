"""The sensor's HTTP interface: its parameters by name, and the software trigger.

After *RF62X description of parameters and commands* (RIFTEK, in RF62X-SDK/Docs), chapter WEB API::

    GET /api/v1/config/params/values?name=user_sensor_framerate   -> {"user_sensor_framerate": 490}
    PUT /api/v1/config/params/values?user_sensor_framerate=100    -> {... : "RF_OK"}
    GET /api/v1/profile/capture?count=1                           software trigger

One request a connection: small servers close it or not, as they like. A `ByteLink` carries it, so
that the wire log and the deadlines are those of every other protocol.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from http.client import HTTPException, parse_headers
from typing import Any
from urllib.parse import urlencode

from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.links import ByteLink

_VALUES = "/api/v1/config/params/values"
_CAPTURE = "/api/v1/profile/capture"
_LONGEST_WAIT_S = 0.05  # the laser's lease is renewed at least so often
_MOST_BYTES = 1 << 20
_END_OF_HEAD = b"\r\n\r\n"
_DONE = ("RF_OK", "OK")


class Connection(Enum):
    """Whether more may come."""

    OPEN = "open"
    CLOSED = "closed"


def parsed(received: bytes, connection: Connection) -> tuple[int, bytes] | None:
    """Status and body of an HTTP answer; None while it is not whole.

    Raises
    ------
    FrameError
        It is none.
    """
    head, found, rest = received.partition(_END_OF_HEAD)
    if not found:
        return None
    status_line, _, fields = head.partition(b"\r\n")
    words = status_line.split(None, 2)
    if len(words) < 2 or not words[0].startswith(b"HTTP/1.") or not words[1].isdigit():
        raise FrameError(f"no HTTP answer: {received[:60]!r}")
    try:
        headers = parse_headers(io.BytesIO(fields + _END_OF_HEAD))
        size = int(headers.get("Content-Length", "-1"))
    except (HTTPException, ValueError) as wrong:
        raise FrameError(f"no HTTP head: {head[:60]!r}") from wrong
    status = int(words[1])
    if "chunked" in headers.get("Transfer-Encoding", "").lower():
        body = _joined_chunks(rest)
    elif size >= 0:
        body = rest[:size] if len(rest) >= size else None
    else:
        body = rest if connection is Connection.CLOSED else None
    return None if body is None else (status, body)


def _joined_chunks(data: bytes) -> bytes | None:
    """The body that came in chunks; None while the last is missing."""
    body = b""
    while True:
        line, found, data = data.partition(b"\r\n")
        if not found:
            return None
        try:
            size = int(line.partition(b";")[0], 16)
        except ValueError as wrong:
            raise FrameError(f"no length of a chunk: {line[:20]!r}") from wrong
        if size == 0:
            return body
        if len(data) < size + 2:
            return None
        body, data = body + data[:size], data[size + 2 :]


class WebApi:
    """Requests to one sensor.

    Parameters
    ----------
    connect
        Opens a connection to it.
    timeout_s
        From the request to the last byte of its answer.
    """

    def __init__(
        self,
        connect: Callable[[], ByteLink],
        address: str,
        *,
        timeout_s: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._connect = connect
        self.address = address
        self._host = address.partition("://")[2]
        self._timeout_s = timeout_s
        self._clock = clock

    def values(self, names: Sequence[str]) -> Mapping[str, Any]:
        """Ask for parameters; those that the sensor does not know are absent."""
        query = urlencode([("name", name) for name in names])
        return self._json(self._ask("GET", f"{_VALUES}?{query}"))

    def put(self, values: Mapping[str, int]) -> None:
        """Write parameters, and read them back.

        Raises
        ------
        Refused
            The sensor's word about the first that it did not take, or that reads back otherwise.
        """
        said = self._json(self._ask("PUT", f"{_VALUES}?{urlencode(values)}"))
        for name, value in values.items():
            if (word := said.get(name, "not mentioned")) not in _DONE:
                raise Refused(f"riftek at {self.address}: {name} = {value}: {word}")
        kept = self.values(list(values))
        for name, value in values.items():
            if kept.get(name) != value:
                raise Refused(
                    f"riftek at {self.address}: {name} reads back as {kept.get(name)} after {value}"
                    " was written; is another program writing it?"
                )

    def capture(self) -> None:
        """Trigger one profile; never asked twice."""
        self._ask("GET", f"{_CAPTURE}?count=1")

    def _json(self, body: bytes) -> Mapping[str, Any]:
        try:
            said = json.loads(body)
        except ValueError as wrong:
            raise FrameError(f"riftek at {self.address}: no JSON: {body[:60]!r}") from wrong
        if not isinstance(said, dict):
            raise FrameError(f"riftek at {self.address}: no parameters: {body[:60]!r}")
        return said

    def _ask(self, method: str, target: str) -> bytes:
        """Return the body of an answer that says 200."""
        head = f"{method} {target} HTTP/1.1\r\nHost: {self._host}\r\nConnection: close\r\n"
        link = self._connect()
        try:
            link.write(f"{head}Content-Length: 0\r\n\r\n".encode("ascii"))
            status, body = self._answer(link)
        finally:
            link.close()
        if status != 200:
            raise Refused(
                f"riftek at {self.address}: {method} {target}: HTTP status {status}", code=status
            )
        return body

    def _answer(self, link: ByteLink) -> tuple[int, bytes]:
        received, deadline_s = b"", self._clock() + self._timeout_s
        while (left_s := deadline_s - self._clock()) > 0.0:
            try:
                received += link.read(min(left_s, _LONGEST_WAIT_S))
            except LinkLost:
                if (answer := parsed(received, Connection.CLOSED)) is None:
                    raise
                return answer
            if (answer := parsed(received, Connection.OPEN)) is not None:
                return answer
            if len(received) > _MOST_BYTES:
                break
        if received:
            raise FrameError(f"riftek at {self.address}: no HTTP answer: {received[:60]!r}")
        raise NoReply(
            f"riftek at {self.address}: no answer in {self._timeout_s:g} s; is it powered, its"
            " address right?"
        )
