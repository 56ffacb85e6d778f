"""strace: whether it may trace here, a program under it, and its log read back."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from acquisition.scanfile import AHEAD

REPOSITORY = Path(__file__).resolve().parents[2]
_PATIENCE_S = 120.0
_CALL = re.compile(r"(?:\[pid +\d+\] )?(?:\d+ +)?(\w+)\((.*)\) += (-?\d+)(?:<.*>)?(?: .*)?$")
_DESCRIPTOR = re.compile(r"(\d+)<([^>]*)>")


@cache
def why_not() -> str:
    """Why nothing can be traced here; empty when it can."""
    if not shutil.which("strace"):
        return "strace is not installed: apt-get install strace"
    tried = subprocess.run(
        ["strace", "-qq", "-e", "inject=write:error=EIO:when=1", "true"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return "" if tried.returncode == 0 else f"ptrace is not permitted here: {tried.stderr.strip()}"


@dataclass(frozen=True)
class Ran:
    """A program that ended: its code (negative: the signal), and what it said."""

    code: int
    told: tuple[int, ...]  # slices that it said to be kept
    stderr: str


def recorder(
    path: Path,
    slices: int,
    manner: str = "careful",
    *,
    ahead: int = AHEAD,
    strace: Sequence[str] = (),
) -> Ran:
    """Run the recorder, under strace with these options if there are any."""
    words = [sys.executable, "-m", "tests.campaigns.recorder", str(path), str(slices)]
    words += [manner, str(ahead)]
    tracer = ["strace", "-f", "-qq", "-o", os.devnull, *strace] if strace else []
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OPENBLAS_NUM_THREADS": "1"}
    ran = subprocess.run(
        [*tracer, *words], cwd=REPOSITORY, env=environment, capture_output=True, text=True,
        timeout=_PATIENCE_S, check=False,
    )  # fmt: skip
    told = tuple(int(each) for each in re.findall(r"^kept (\d+)$", ran.stdout, re.MULTILINE))
    return Ran(ran.returncode, told, ran.stderr)


def injected(call: str, what: str, number: int) -> tuple[str, ...]:
    """Options that do something to a program's call of this name and number."""
    return ("-e", f"trace={call}", "-e", f"inject={call}:{what}:when={number}")


@dataclass(frozen=True)
class Call:
    """One call to the kernel that came back well."""

    name: str
    paths: tuple[str, ...]  # of its descriptor, or those it names
    data: bytes = b""
    flags: str = ""


def calls(log: Path) -> Iterator[Call]:
    """Read a log of ``strace -y -xx``; calls that failed changed nothing."""
    for line in log.read_text().splitlines():
        found = _CALL.fullmatch(line)
        if found is None or int(found[3]) < 0:
            continue
        name, words, result = found[1], found[2], int(found[3])
        texts = [_unhexed(each) for each in re.findall(r'"((?:\\x[0-9a-f]{2})*)"', words)]
        descriptor = _DESCRIPTOR.match(words)
        if name == "openat":
            yield Call(name, (texts[0].decode(),), flags=words)
        elif name in {"write", "pwrite64"} and descriptor:
            yield Call(name, (_unhexed(descriptor[2]).decode(),), texts[0][:result])
        elif name in {"fsync", "fdatasync", "ftruncate"} and descriptor:
            yield Call(name, (_unhexed(descriptor[2]).decode(),))
        elif texts:
            yield Call(name, tuple(each.decode() for each in texts))


def _unhexed(text: str) -> bytes:
    if "\\x" not in text:
        return text.encode()
    return bytes.fromhex(text.replace("\\x", ""))
