"""Writers of a .scan folder that are killed, one child each; run as a program by test_durability.

``dying_writer.py instants FOLDER SEEDS`` kills each child from outside after a random number of
acknowledgements and a random while. ``dying_writer.py calls FOLDER`` lets each child kill itself at
its first call to the kernel that matters, then at its second, and so on until one comes through.
Each line of the output is a folder's name and the slices that were acknowledged there.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from tests.acquisition.scan_cases import record, sweep

SLICES = 3


def scan(path: Path, acknowledgements: int) -> None:
    with ScanFolder.create(path, record(SLICES)) as writer:
        for index in range(SLICES):
            writer.append(sweep(index, profiles=4, points=1000))
            os.write(acknowledgements, bytes([index]))
        writer.finish(State.COMPLETE)


def in_a_child(work: Callable[[int], None], watch: Callable[[int, int], bytes]) -> list[int]:
    """Run `work` in a child with the writing end of a pipe; give what it acknowledged."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        work(writing)
        os._exit(0)
    os.close(writing)
    acknowledged = watch(child, reading)
    while more := os.read(reading, 100):
        acknowledged += more
    os.close(reading)
    os.waitpid(child, 0)
    return list(acknowledged)


def killed_at_an_instant(path: Path, seed: int) -> list[int]:
    rng = random.Random(seed)

    def watch(child: int, reading: int) -> bytes:
        heard = b""
        for _ in range(rng.randrange(SLICES)):
            heard += os.read(reading, 1)
        time.sleep(rng.uniform(0.0, 0.004))
        os.kill(child, signal.SIGKILL)
        return heard

    return in_a_child(lambda writing: scan(path, writing), watch)


def killed_at_a_call(path: Path, number: int) -> list[int]:
    """Kill the child before its call of this number; a write dies half done."""
    left = [number]

    def dying(call: Callable[..., Any]) -> Callable[..., Any]:
        def instead(*arguments: Any, **options: Any) -> Any:
            left[0] -= 1
            if left[0] == 0:
                if call is os_write:
                    call(arguments[0], arguments[1][: len(arguments[1]) // 2])
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments, **options)

        return instead

    def work(writing: int) -> None:
        os.open, os.fsync, os.ftruncate = dying(os.open), dying(os.fsync), dying(os.ftruncate)
        Path.replace = dying(Path.replace)  # type: ignore[method-assign]
        os.write = dying(os_write)
        scan(path, writing)

    os_write = os.write
    return in_a_child(work, lambda _child, _reading: b"")


def main(mode: str, folder: Path, seeds: int) -> None:
    for number in range(1, seeds + 1):
        path = folder / f"{number}.scan"
        kill = killed_at_an_instant if mode == "instants" else killed_at_a_call
        acknowledged = kill(path, number)
        print(path.name, *acknowledged, flush=True)  # noqa: T201
        if mode == "calls" and len(acknowledged) == SLICES and ended(path):
            return


def ended(path: Path) -> bool:
    return ScanFolder.open(path).record().state is State.COMPLETE


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
