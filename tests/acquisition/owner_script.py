"""An owner that lights a laser on a wire of the test's and then dies, hangs, or goes on.

    python -m tests.acquisition.owner_script ADDRESS HOW REPORT

It tells in a line a word what it does: "lit", then when it falls silent or ends, a time each.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from pathlib import Path

from acquisition.lease import TTL_S, Lease
from acquisition.safety.guarding import guarded
from acquisition.safety.places import places_of
from drivers.links import open_link
from drivers.recipes import Order, Recipe, Word

RECIPE = Recipe(
    "lamp", Order.LASER, (Word(b"off\n", b"dark\n", 0.2),), (Word(b"lit?\n", b"no\n", 0.2),)
)
SILENT_S = 2.0


def fall(how: str) -> None:
    match how:
        case "SIGKILL" | "SIGSEGV" | "SIGSTOP":
            os.kill(os.getpid(), getattr(signal, how))
        case "os._exit":
            os._exit(7)
        case "GIL held":
            ctypes.PyDLL(None).sleep(2)  # PyDLL: the interpreter is not let go of
        case "sleeping":
            time.sleep(SILENT_S)
        case "forked":
            if os.fork() == 0:  # a child that has every descriptor, and outlives us
                time.sleep(SILENT_S)
                os._exit(0)
            os._exit(7)
        case "left lit" | "fine":
            return
    time.sleep(SILENT_S)


def main(address: str, how: str, report: str) -> None:
    with guarded(places_of([address]), time.sleep) as guard:
        link = open_link(address)
        guard.report_to(Path(report))
        guard.hold(link, [RECIPE])
        lease = Lease(TTL_S, time.monotonic, guard)
        lease.take()
        link.write(b"on\n")
        for _ in range(10):
            time.sleep(0.02)
            lease.renew()
        sys.stdout.write(f"lit {time.monotonic()}\n")
        sys.stdout.flush()
        fall(how)
        if how not in ("left lit", "fine"):
            link.write(b"on\n")  # what a program that goes on might do
        if how == "fine":
            link.write(b"off\n")
            lease.give_back()
        link.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
