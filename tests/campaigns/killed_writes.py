"""What was told to be kept is kept: killed, cut off and starved at every call to the kernel.

    python -m tests.campaigns.killed_writes [--slices 20] [--only kill,power,fail,station]

kill      strace kills a recorder at its first write, its second, ... until one comes through; so
          with every other call that changes the disk. Then the recorder goes on with the rest.
power     the calls of one recorder are replayed on a disk that forgets what was not synced
          (`tests.campaigns.power_loss`), to every state that a power cut may leave.
fail      every such call fails, by ENOSPC or EIO.
station   ``loftscan scan`` of a simulated station is killed at every write into its folder,
          resumed, and its witness says that the laser is off; the same with ENOSPC and EIO.

Judged each time: what was told is there, byte for byte, nothing is there twice or damaged, and the
scan can be completed. Exits 1 when a slice is lost.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.errors import NotAScan
from acquisition.scan_record import State
from acquisition.scanfile import AHEAD, ScanFolder
from acquisition.sweep_codec import encode_sweep
from tests.acquisition.scan_cases import record, sweep
from tests.campaigns.power_loss import images
from tests.campaigns.tracing import Ran, calls, injected, recorder, why_not

CHANGING = (
    "write",
    "pwrite64",
    "fsync",
    "rename",
    "openat",
    "ftruncate",
    "mkdir",
    "unlink",
    "flock",
)
_LOGGED = "openat,write,pwrite64,fsync,fdatasync,rename,ftruncate,mkdir,unlink"


@dataclass
class Tally:
    """What came of many cases."""

    cases: Counter[str] = field(default_factory=Counter)
    lost: int = 0
    twice: int = 0
    wrong: list[str] = field(default_factory=list)


def judge(path: Path, told: tuple[int, ...], slices: int, tally: Tally, case: str) -> None:
    """Hold a folder against what was told, and finish its scan."""
    tally.twice += len(told) - len(set(told))
    if not (path / "scan.json").exists():
        tally.lost += len(told)
        try:
            ScanFolder.create(path, record(slices)).close()  # killed before there was a scan
        except FileExistsError as rest:
            tally.wrong.append(f"{case}: {rest}")
        return
    try:
        folder = ScanFolder.open(path)
    except NotAScan as bad:
        tally.lost += len(told)
        tally.wrong.append(f"{case}: {bad}")
        return
    damaged = folder.verify().damaged
    with folder.resume() as writer:
        # Only now: after a power cut a slice may be whole and without its name till it is resumed.
        there = folder.verify().sound
        whole = {i for i in there if folder.file(i).read_bytes() == encode_sweep(sweep(i))}
        gone = set(told) - whole | set(there) - whole
        for index in writer.folder.missing():
            writer.append(sweep(index))
        writer.finish(State.COMPLETE)
    tally.lost += len(gone)
    if gone or damaged:
        tally.wrong.append(f"{case}: lost {sorted(gone)}, damaged {damaged}")
    rests = list(folder.path.rglob(".*.part"))
    if folder.verify().sound != tuple(range(slices)) or rests:
        tally.wrong.append(f"{case}: cannot be finished; rests {rests}")


def kills(place: Path, slices: int, call: str, tally: Tally, step: int = 1) -> None:
    """Kill a recorder at each of its calls of a name, until one comes through."""
    for number in _numbers(call, slices, step):
        path = place / f"{call}-{number}.scan"
        ran = recorder(path, slices, strace=options_at(path, slices, call, "signal=KILL", number))
        tally.cases[call] += 1
        if ran.code == 0:
            return
        judge(path, ran.told, slices, tally, f"killed at {call} {number}")
    raise AssertionError(f"no recorder came through {call}")


def failures(place: Path, slices: int, call: str, error: str, tally: Tally, step: int = 1) -> None:
    """Let each call of a name fail once, until a recorder meets none."""
    for number in _numbers(call, slices, step):
        path = place / f"{call}-{error}-{number}.scan"
        ran = recorder(
            path, slices, strace=options_at(path, slices, call, f"error={error}", number)
        )
        tally.cases[f"{call} {error}"] += 1
        if ran.code == 0:
            return
        _check_line(ran, path, tally, f"{call} {number} {error}")
        judge(path, ran.told, slices, tally, f"{call} {number} {error}")
    raise AssertionError(f"no recorder came through {call}")


def _check_line(ran: Ran, path: Path, tally: Tally, case: str) -> None:
    """One line that names the folder and the remedy."""
    remedies = ("free some space", "copy the folder to another disk")
    said = ran.stderr.strip()
    named = str(path) in said and any(remedy in said for remedy in remedies)
    if ran.code != 1 or "\n" in said or not named:
        tally.wrong.append(f"{case}: exit code {ran.code}, said {said[-300:]!r}")


def _numbers(call: str, slices: int, step: int) -> Iterator[int]:
    return iter(range(1, 40 * slices + 200, step))


def options_at(path: Path, slices: int, call: str, what: str, number: int) -> list[str]:
    """Of all calls of the program, those that touch the scan's folder."""
    names = [
        "",
        ".lock",
        "slices",
        *(
            f"{dot}{each}{end}"
            for each in ("scan.json", "scan.spare.json")
            for dot, end in (("", ""), (".", ".part"))
        ),
    ]
    names += [f"slices/.ahead-{number}.part" for number in range(slices + AHEAD)]
    names += [f"slices/{index:06d}.npz" for index in range(slices)]
    paths = [word for name in names for word in ("-P", str(path / name))]
    return [*injected(call, what, number), *paths]


def traced(place: Path, slices: int, manner: str, ahead: int) -> tuple[Path, Path]:
    """Record a scan; give its folder and the log of its calls."""
    path, log = place / "traced.scan", place / "log"
    options = ["-y", "-xx", "-s", "100000000", "-o", str(log), "-e", f"trace={_LOGGED}"]
    ran = recorder(path, slices, manner, ahead=ahead, strace=options)
    if ran.code or len(ran.told) != slices:
        raise AssertionError(ran.stderr)
    return path, log


def power_cuts(
    place: Path, slices: int, tally: Tally, manner: str = "careful", ahead: int = AHEAD
) -> None:
    """Judge every state, once, that a power cut at any instant may leave."""
    path, log = traced(place, slices, manner, ahead)
    seen = set()
    for number, image in enumerate(images(list(calls(log)), str(path))):
        if (image.files, image.told) in seen:
            continue
        seen.add((image.files, image.told))
        cut = place / f"cut-{number}.scan"
        (cut / "slices").mkdir(parents=True)
        image.write(cut, str(path))
        tally.cases["power cut"] += 1
        judge(cut, image.told, slices, tally, f"cut after call {image.call}")


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def tell(tally: Tally, of: str) -> bool:
    """Print a line of the table; whether all was well."""
    cases = ", ".join(f"{name} {count}" for name, count in tally.cases.items())
    say(f"{of:<8} {sum(tally.cases.values()):>6} cases  {tally.lost} lost  {tally.twice} twice"
          f"  {len(tally.wrong)} wrong   ({cases})")  # fmt: skip
    for each in tally.wrong[:5]:
        say(f"    {each}")
    return not (tally.lost or tally.twice or tally.wrong)


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slices", type=int, default=20)
    parser.add_argument("--only", default="kill,power,fail,station")
    chosen = parser.parse_args(words)
    if reason := why_not():
        say(reason)
        return 1
    shared = Path("/dev/shm")
    well = True
    with tempfile.TemporaryDirectory(dir=shared if os.access(shared, os.W_OK) else None) as folder:
        for kind in chosen.only.split(","):
            tally, place = Tally(), Path(folder) / kind
            place.mkdir()
            _run(kind, place, chosen.slices, tally)
            well &= tell(tally, kind)
    return 0 if well else 1


def _run(kind: str, place: Path, slices: int, tally: Tally) -> None:
    if kind == "kill":
        for call in CHANGING:
            kills(place, slices, call, tally)
    elif kind == "fail":
        for error in ("ENOSPC", "EIO"):
            for call in CHANGING[:6]:
                failures(place, slices, call, error, tally)
    elif kind == "power":
        power_cuts(place, slices, tally)
    else:
        from tests.campaigns.killed_scans import killed_scans

        killed_scans(place, slices, tally)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
