r"""The devices' end of the line: commands found in the bytes, done, answered.

After the ASCII protocol manual. A line begins with `/`, ends with ``\n`` or ``\r``; what stands
before the `/` is nobody's. Device 0 is everybody, an axis of 0 the whole device. A command whose
check is wrong is not executed and not answered; one without a check is taken. An id is given back.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from sim.zaber.device import Answer, ZaberDevice

_MOST = 80  # characters of a command
_CHECKED = re.compile(r"(.*):([0-9A-Fa-f]{2})")


class ZaberChain:
    """A `sim.device.Device`: one port, devices by their number."""

    def __init__(self, devices: Mapping[int, ZaberDevice]) -> None:
        for number in devices:
            if number not in range(1, 100):
                raise ValueError(f"zaber: {number} is no number of a device, 1 to 99 are")
        self._devices = dict(devices)
        self._line = ""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take characters off the wire, in whatever pieces they come; return the answers."""
        said = self.tick(now_s)
        for letter in data.decode("latin-1"):
            if letter not in "\r\n":
                self._line += letter
                continue
            line, self._line = self._line, ""
            said += self._heard(line, now_s)
        return said

    def tick(self, now_s: float) -> bytes:
        """Let time pass for the devices; return their alerts."""
        said = b""
        for number, device in self._devices.items():
            for axis, state, flag in device.tick(now_s):
                said += _message("!", f"{number:02d} {axis} {state} {flag}", device)
        return said

    def _heard(self, line: str, now_s: float) -> bytes:
        _, slash, body = line.partition("/")
        if not slash or len(body) > _MOST:
            return b""
        if found := _CHECKED.fullmatch(body):
            if (sum(found[1].encode("latin-1")) + int(found[2], 16)) % 256:
                return b""
            body = found[1]
        numbers, words = _split(body)
        called = numbers[0] if numbers else 0
        axis = numbers[1] if len(numbers) > 1 else 0
        given = f" {numbers[2]:02d}" if len(numbers) > 2 else ""
        said = b""
        for number, device in self._devices.items():
            if called in (0, number):
                said += self._answered(number, device, axis, given, words, now_s)
        return said

    def _answered(
        self, number: int, device: ZaberDevice, axis: int, given: str, words: Sequence[str],
        now_s: float,
    ) -> bytes:  # fmt: skip
        answer: Answer = device.do(axis, words, now_s)
        taken = "OK" if answer.taken else "RJ"
        state, flag = device.seen(now_s)
        head = f"{number:02d} {axis}{given}"
        said = _message("@", f"{head} {taken} {state} {flag} {answer.data}", device)
        return said + b"".join(_message("#", f"{head} {text}", device) for text in answer.infos)


def _split(body: str) -> tuple[list[int], list[str]]:
    """The numbers that lead, three at most, and the words behind them."""
    words = body.split()
    numbers: list[int] = []
    while words and words[0].isdecimal() and len(numbers) < 3:
        numbers.append(int(words.pop(0)))
    return numbers, words


def _message(kind: str, body: str, device: ZaberDevice) -> bytes:
    if not device.sends_checks:
        return f"{kind}{body}\r\n".encode()
    check = (256 - sum(body.encode()) % 256) % 256
    return f"{kind}{body}:{check:02X}\r\n".encode()
