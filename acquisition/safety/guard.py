"""The process that turns the laser off when its owner cannot: the second owner of the wires.

    python -I -S guard.py CHANNEL OWNER_PID

Run by this file's path with the standard library only, so that nothing of the project, and no
library that it needs, can keep it from starting or from acting. It knows no protocol: it is handed
open descriptors over a Unix socket (SCM_RIGHTS), with recipes of bytes (`drivers.recipes`), and a
lease whose end it watches::

    owner   hold: descriptor, recipe    lease until t   lease until t'   ...   bye
              '--------------------------------'---------------'----------------'--> ends
    guard                                                            |
                                     t' goes by, the channel closes, or the owner's process ends:
                                     SIGKILL, reaped > flush > quiet > off, stop, three times >
                                     read back > report > descriptors and locks let go

The owner is killed first, for a program that is stopped or hangs could light the laser again when
it goes on; nothing is said on a wire before it is dead. Times are the monotonic clock's, which all
processes of a machine share: a lease that was written down before a stall ends when it says.

A TCP device is told on the connection that was passed: what the owner had sent is ahead of us there
and cannot overtake us, and the device need not admit another client. Where that goes unconfirmed,
the connection is reset, which drops what it still held, and the device is told on a new one.

Linux only: SOCK_SEQPACKET, SCM_RIGHTS, pidfd.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import select
import signal
import socket
import struct
import sys
import termios
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

TIMES = 3  # every off and stop
DEAD_WITHIN_S = 0.05  # a process in the kernel's hands may take longer: then it cannot light either
STALLED_S = 0.02  # who wakes so late was stalled himself, and the owner with him: one more look
TAKES_BYTES_S = 0.1
CHECK_EVERY_S = 0.01
CONNECT_S = 0.5
REPORT_AFTER_S = 3.0  # of the slowest wire
LAPSED = "the lease lapsed"
HUNG = (
    "; it hung, or this machine was too busy for it: end other work; slices that were kept are"
    " safe, go on with --resume"
)
LEASE = struct.Struct("<cq")  # b"L", monotonic ns; 0: given back
MESSAGE_BYTES = 1 << 16
RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # SO_LINGER

Table = dict[str, Any]  # of JSON


class Held:
    """An open descriptor, who can be told what on it, and where it leads."""

    def __init__(self, descriptor: int, recipes: Sequence[Table]) -> None:
        self.descriptor = descriptor
        self.recipes = sorted(recipes, key=lambda recipe: recipe["order"])
        self.terminal = os.isatty(descriptor)
        self.peer = None if self.terminal else _peer(descriptor)

    def close(self) -> None:
        """Forget it; an owner that lives has it still."""
        with contextlib.suppress(OSError):
            os.close(self.descriptor)

    def free(self) -> None:
        """Let the next owner open it."""
        if self.terminal:  # a mark that outlives who made it while others have the port open
            with contextlib.suppress(OSError, termios.error):
                fcntl.ioctl(self.descriptor, termios.TIOCNXCL)
        self.close()


class Guard:
    """What was handed over, until when the laser may be on, and what becomes of it."""

    def __init__(self, channel: socket.socket, owner: int) -> None:
        self.channel = channel
        self.owner = owner
        self.process = _pidfd(owner)
        self.held: dict[str, Held] = {}
        self.locks: list[tuple[str, int]] = []
        self.report_file = ""
        self.lease_ns = 0  # 0: none

    def watch(self) -> str:
        """Listen until there is a reason to act, or none ever again; the reason, or ""."""
        poll = select.poll()
        poll.register(self.channel, select.POLLIN)
        if self.process is not None:
            poll.register(self.process, select.POLLIN)
        while True:
            ready = {descriptor for descriptor, _ in poll.poll(self._patience_ms())}
            if self.channel.fileno() in ready:
                said = self._hear()
                if said is not None:
                    return said
            elif self.process is not None and self.process in ready:
                return "its owner ended"
            late_s = self._late_s()
            if late_s > STALLED_S and not ready:
                time.sleep(STALLED_S)
                if (said := self._hear()) is not None:
                    return said
                late_s = self._late_s()
            if late_s > 0.0 and not self._more():
                return f"{LAPSED} {1000.0 * late_s:.0f} ms ago"

    def _more(self) -> bool:
        """Whether the channel has words that were not heard yet: one may be a renewal."""
        return bool(select.select([self.channel], [], [], 0.0)[0])

    def _patience_ms(self) -> int | None:
        if not self.lease_ns:
            return None
        left_ns = self.lease_ns - time.monotonic_ns()
        return max(0, -(-left_ns // 1_000_000))

    def _late_s(self) -> float:
        """Seconds since the lease ended; negative while it holds, or where there is none."""
        return (time.monotonic_ns() - self.lease_ns) / 1e9 if self.lease_ns else -1.0

    def _hear(self) -> str | None:
        """Take what was said; a reason to act, or "" for an end in peace, or None."""
        while self._more():
            try:
                data, descriptors, _, _ = socket.recv_fds(self.channel, MESSAGE_BYTES, 4)
            except OSError as gone:
                return f"its channel broke ({gone})"
            if not data:
                return "its owner closed the channel"
            if data[:1] == b"L":
                self.lease_ns = LEASE.unpack(data)[1]
                continue
            ended = self._take(json.loads(data), descriptors)
            if ended is not None:
                return ended
        return None

    def _take(self, said: Table, descriptors: Sequence[int]) -> str | None:
        match said["word"]:
            case "take":
                self.lease_ns = said["until_ns"]
                self.answer(ok=True)
            case "hold":
                self._drop(said["key"])
                self.held[said["key"]] = Held(descriptors[0], said["recipes"])
                self.answer(ok=True)
            case "drop":
                self._drop(said["key"])
                self.answer(ok=True)
            case "lock":
                self.answer(**self._lock(said["files"]))
            case "unlock":
                self._unlock(said["files"])
                self.answer(ok=True)
            case "report":
                self.report_file = said["file"]
                self.answer(ok=True)
            case "bye":
                return "its owner left with the laser not seen to be off" if self.lease_ns else ""
        return None

    def answer(self, **words: object) -> None:
        """Say something to the owner, if it is still there."""
        with contextlib.suppress(OSError):
            self.channel.send(json.dumps(words).encode())

    def _drop(self, key: str) -> None:
        if key in self.held:
            self.held.pop(key).close()

    def _lock(self, files: Sequence[str]) -> Table:
        """Take every lock or none; who holds the first that is not free."""
        taken: list[tuple[str, int]] = []
        for file in files:
            descriptor, holder = _locked(file)
            taken.append((file, descriptor))
            if holder is not None:
                for _, each in taken:
                    os.close(each)
                return {"ok": False, "file": file, "holder": holder}
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, b"%d\n" % self.owner, 0)
        self.locks += taken
        return {"ok": True}

    def _unlock(self, files: Sequence[str]) -> None:
        for file, lock in [each for each in self.locks if each[0] in files]:
            self.locks.remove((file, lock))
            with contextlib.suppress(OSError):
                Path(file).unlink()
            os.close(lock)

    def let_go(self) -> None:
        """Close every wire, then let the next owner in."""
        for held in self.held.values():
            held.free()
        self._unlock([file for file, _ in self.locks])

    def act(self, why: str) -> Table:
        """Kill, then say every recipe, each wire by a thread of its own; what came of it."""
        since_s = time.monotonic()
        killed = "left by itself" if why.startswith("its owner left") else self._kill()
        found: list[Table] = []
        threads = [
            threading.Thread(target=_serve, args=(held, found, since_s), daemon=True)
            for held in self.held.values()
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(max(0.0, since_s + REPORT_AFTER_S - time.monotonic()))
        told = {recipe["device"] for recipe in found}
        missing = [
            {
                "device": recipe["device"],
                "order": recipe["order"],
                "sent_ms": None,
                "confirmed": False,
                "came": "",
            }
            for held in self.held.values()
            for recipe in held.recipes
            if recipe["device"] not in told
        ]
        return {
            "event": "guard acted",
            "why": why,
            "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "monotonic_s": round(since_s, 6),
            "owner": self.owner,
            "owner_end": killed,
            "devices": sorted([*found, *missing], key=lambda told: told["order"]),
        }

    def _kill(self) -> str:
        """SIGKILL, and wait until the process is gone: only then are the wires ours."""
        if self.process is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.owner, signal.SIGKILL)
            time.sleep(0.005)
            return "killed"
        if select.select([self.process], [], [], 0.0)[0]:
            return "dead before"
        _urgent(self.owner)  # a process dies in its own time: on a busy machine it waits for that
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self.process, signal.SIGKILL)
        gone = select.select([self.process], [], [], DEAD_WITHIN_S)[0]
        return "killed" if gone else "killed, but not gone yet"

    def keep(self, report: Table) -> None:
        """Leave the report beside the scan."""
        if self.report_file:
            with contextlib.suppress(OSError):
                flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
                file = os.open(self.report_file, flags, 0o644)
                os.write(file, json.dumps(report).encode() + b"\n")
                os.close(file)


def _locked(file: str) -> tuple[int, str | None]:
    """Open a lock file and take its lock; who has it, if somebody has.

    Whoever lets go removes the file first: a lock on one that is gone is worth nothing, and the
    next is tried.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
    while True:
        descriptor = os.open(file, flags, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return descriptor, os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(Path(file).stat(), os.fstat(descriptor)):
                return descriptor, None
        os.close(descriptor)


def _serve(held: Held, found: list[Table], since_s: float) -> None:
    """Everything that is to be said on one wire."""
    wire = Wire(held)
    for recipe in held.recipes:
        told = wire.tell(recipe, since_s)
        if not told["confirmed"] and wire.connect_anew():
            told = wire.tell(recipe, since_s) | {"connection": "new"}
        found.append(told)


class Wire:
    """A descriptor that is spoken on, and nothing on it that may wait for ever."""

    def __init__(self, held: Held) -> None:
        self._held = held
        with contextlib.suppress(OSError):
            os.set_blocking(held.descriptor, False)
        if held.terminal:
            with contextlib.suppress(OSError, termios.error):
                termios.tcflush(held.descriptor, termios.TCIOFLUSH)

    def tell(self, recipe: Table, since_s: float) -> Table:
        """Off or stop three times, then read back."""
        self._quiet(recipe["quiet_s"])
        sent_ms, came = None, b""
        for _ in range(TIMES):
            for word in recipe["words"]:
                _, sent, came = self._say(word, came)
                if sent and sent_ms is None:
                    sent_ms = round(1000.0 * (time.monotonic() - since_s), 1)
        confirmed = False
        tries, rest_s = TIMES, time.monotonic() + recipe["rest_s"]
        while recipe["check"] and not confirmed and (tries > 0 or time.monotonic() < rest_s):
            time.sleep(CHECK_EVERY_S if tries < TIMES else 0.0)
            tries -= 1
            replies = [self._say(word, b"") for word in recipe["check"]]
            confirmed = all(answered for answered, _, _ in replies)
            came = b"".join(reply for _, _, reply in replies)
        done_ms = round(1000.0 * (time.monotonic() - since_s), 1)
        return {
            "device": recipe["device"],
            "order": recipe["order"],
            "sent_ms": sent_ms,
            "confirmed": confirmed,
            "done_ms": done_ms,
            "came": came[-64:].hex(" "),
        }

    def connect_anew(self) -> bool:
        """Reset the connection and open another in its place."""
        if self._held.peer is None:
            return False
        try:
            with socket.socket(fileno=os.dup(self._held.descriptor)) as old:
                old.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
            os.close(self._held.descriptor)
            fresh = socket.create_connection(self._held.peer, timeout=CONNECT_S)
            fresh.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            fresh.settimeout(0.0)
            self._held.descriptor = fresh.detach()
        except OSError:
            return False
        return True

    def _quiet(self, quiet_s: float) -> None:
        """Hear the line out: `quiet_s` of silence, but wait for it no longer than twice that."""
        begun_s = heard_s = time.monotonic()
        while (now_s := time.monotonic()) < min(heard_s + quiet_s, begun_s + 2.0 * quiet_s):
            if self._read(min(heard_s + quiet_s, begun_s + 2.0 * quiet_s) - now_s):
                heard_s = time.monotonic()

    def _say(self, word: Table, came: bytes) -> tuple[bool, bool, bytes]:
        """Send one word; whether its answer came, whether it was sent, and what came."""
        self._read(0.0)
        sent = self._write(bytes.fromhex(word["send"]))
        pattern = re.compile(bytes.fromhex(word["reply"]), re.DOTALL)
        deadline_s = time.monotonic() + word["within_s"]
        received = b""
        while word["reply"] and not pattern.search(received):
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0 or not sent:
                return False, sent, received or came
            received += self._read(left_s)
        if not word["reply"] and sent:
            time.sleep(word["within_s"])
        return sent, sent, received or came

    def _write(self, data: bytes) -> bool:
        deadline_s = time.monotonic() + TAKES_BYTES_S
        while data and (left_s := deadline_s - time.monotonic()) > 0.0:
            try:
                if select.select([], [self._held.descriptor], [], left_s)[1]:
                    data = data[os.write(self._held.descriptor, data) :]
            except (BlockingIOError, InterruptedError):
                continue
            except (OSError, ValueError):
                return False
        return not data

    def _read(self, timeout_s: float) -> bytes:
        """What has come, waiting for it at most so long; a wire that is gone is a long silence."""
        try:
            if not select.select([self._held.descriptor], [], [], max(timeout_s, 0.0))[0]:
                return b""
            data = os.read(self._held.descriptor, 4096)
        except (BlockingIOError, InterruptedError):
            return b""
        except (OSError, ValueError):
            data = b""
        if not data:  # a closed peer is readable for ever
            time.sleep(min(max(timeout_s, 0.0), 0.02))
        return data


def sentence(report: Table) -> str:
    """What a person must know, in one line."""
    parts = []
    at_rest = {device["device"] for device in report["devices"] if device["confirmed"]}
    for device in report["devices"]:
        if device["confirmed"]:
            parts.append(f"{device['device']}: at rest, read back after {device['done_ms']:g} ms")
        elif f"{device['device']}, reset" in at_rest:
            parts.append(f"{device['device']}: told, and reset")
        else:
            said = "told" if device["sent_ms"] is not None else "could not be told"
            parts.append(f"{device['device']}: {said}, NOT confirmed: press the emergency stop")
    ended = report["owner_end"]
    remedy = HUNG if report["why"].startswith(LAPSED) else ""
    return (
        f"loftscan guard: {report['why']}; process {report['owner']} {ended};"
        f" {'; '.join(parts) or 'no device was handed over'}{remedy}"
    )


def _pidfd(process: int) -> int | None:
    try:
        return os.pidfd_open(process)
    except (AttributeError, OSError):  # an old kernel, or it is dead already: the channel says so
        return None


def _peer(descriptor: int) -> tuple[str, int] | None:
    """Where a TCP connection leads; None for what is none."""
    try:
        with socket.socket(fileno=os.dup(descriptor)) as twin:
            if twin.type != socket.SOCK_STREAM:
                return None
            host, port = twin.getpeername()[:2]
            return str(host), int(port)
    except OSError:
        return None


def _urgent(process: int) -> None:
    """Have a process, 0 for this one, scheduled before all others, where we may."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(process, os.SCHED_RR, os.sched_param(1))
        return
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process, -10)


def main(words: Sequence[str]) -> None:
    """Guard until the owner says goodbye, or is no more."""
    channel, owner = socket.socket(fileno=int(words[0])), int(words[1])
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    _urgent(0)
    guard = Guard(channel, owner)
    guard.answer(ok=True)
    why = guard.watch()
    report = guard.act(why) if why else None
    if report is not None:
        guard.keep(report)
    guard.let_go()
    guard.answer(ok=True, report=report)
    if report is not None:  # the last, since whoever reads it may not
        with contextlib.suppress(OSError):
            os.write(2, sentence(report).encode() + b"\n")


if __name__ == "__main__":
    main(sys.argv[1:])
