"""The sensor's web server: one request after the other on a connection that its client closes.

Paths and answers after RIFTEK's *description of parameters and commands*; return codes after
`lib/RFProfile.V1.js` of the emulator.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol
from urllib.parse import parse_qsl, urlsplit

_HEAD_ENDS = b"\r\n\r\n"
_MOST_BYTES = 8192
_REASONS = {200: "OK", 400: "Bad Request", 404: "Not Found"}


class Parameters(Protocol):
    """What is asked for and written over HTTP."""

    def values(self, names: Sequence[str]) -> Mapping[str, Any]:
        """Those of these names that there are; all of them without names."""
        ...

    def write(self, name: str, text: str) -> str:
        """Write one; its return code."""
        ...

    def capture(self, count: int, now_s: float) -> str:
        """Measure by software's wish."""
        ...


class HttpSession:
    """One connection; what is no HTTP makes it `lost`."""

    def __init__(self, parameters: Parameters) -> None:
        self.lost = False
        self._parameters = parameters
        self._received = b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes; answer whole requests."""
        self._received += data
        answers = b""
        while _HEAD_ENDS in self._received:
            head, _, self._received = self._received.partition(_HEAD_ENDS)
            answers += self._answer(head.split(b"\r\n")[0].decode("latin-1"), now_s)
        self.lost = len(self._received) > _MOST_BYTES
        return answers

    def tick(self, now_s: float) -> bytes:
        """Nothing is said unasked."""
        return b""

    def _answer(self, line: str, now_s: float) -> bytes:
        words = line.split(" ")
        if len(words) != 3 or not words[2].startswith("HTTP/1."):
            return _said(400, {})
        method, target = words[0], urlsplit(words[1])
        serve = self._paths().get((method, target.path))
        if serve is None:
            return _said(404, {"result": "RF_NOT_FOUND"})
        return _said(200, serve(parse_qsl(target.query, keep_blank_values=True), now_s))

    def _paths(self) -> Mapping[tuple[str, str], Callable[[_Query, float], Mapping[str, Any]]]:
        values, told = "/api/v1/config/params/values", self._parameters
        return {
            ("GET", "/hello"): lambda _, __: told.values(
                [name for name in told.values([]) if name.startswith("fact_general")]
            ),
            ("GET", values): lambda query, _: told.values(
                [text for name, text in query if name == "name"]
            ),
            ("PUT", values): lambda query, _: {
                name: told.write(name, text) for name, text in query
            },
            ("GET", "/api/v1/profile/capture"): self._capture,
        }

    def _capture(self, query: _Query, now_s: float) -> Mapping[str, Any]:
        text = dict(query).get("count", "")
        if not text.isdecimal() or not int(text):
            return {"result": "RF_WRONG_ARGUMENT"}
        return {"result": self._parameters.capture(int(text), now_s)}


_Query = Sequence[tuple[str, str]]


def _said(status: int, values: Mapping[str, Any]) -> bytes:
    body = json.dumps(values).encode()
    head = (
        f"HTTP/1.1 {status} {_REASONS[status]}\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n"
    )
    return head.encode() + body
