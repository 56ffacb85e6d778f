"""How fast slices are kept, beside the raw disk; and whether memory stays flat.

    python benchmarks/recording.py [--folder DIR] [--slices 50] [--many 10000] [--rounds 7]

Raw is the least that makes as many bytes last: a new file each, write, fsync. Keeping a slice is
its encoding with the checksum, the same write and fsync, the rename and the fsync of the folder.
The two take turns, slice by slice, so that whatever else the disk does meets both; told is the
median of the rounds' ratios of medians. Then so many small slices are kept in one scan, and the
memory of the process is read after every tenth of them.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from acquisition.poses import Sweep
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder, ScanWriter
from acquisition.sweep_codec import encode_sweep
from tests.acquisition.scan_cases import record, sweep

_SIZES = ((4, 1000), (100, 640), (360, 1280))  # profiles of a slice and points of a profile
_SMALL = (4, 200)


def raw_s(file: Path, data: bytes) -> float:
    """Seconds for a new file of these bytes, synced."""
    begun_s = time.perf_counter()
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
    os.write(descriptor, data)
    os.fsync(descriptor)
    os.close(descriptor)
    return time.perf_counter() - begun_s


def kept_s(writer: ScanWriter, taken: Sweep) -> float:
    """Seconds for keeping a sweep."""
    begun_s = time.perf_counter()
    writer.append(taken)
    return time.perf_counter() - begun_s


def rates(folder: Path, size: tuple[int, int], slices: int, rounds: int) -> None:
    """Print a line: both rates, and the ratio of the rounds."""
    taken = sweep(0, *size)
    data = encode_sweep(taken)
    raw, kept = [], []
    with ScanFolder.create(folder / "rates.scan", record(slices * rounds)) as writer:
        for index in range(slices * rounds):
            raw.append(raw_s(folder / f"{index}.raw", data))
            kept.append(kept_s(writer, replace(taken, index=index)))
    starts = range(0, slices * rounds, slices)
    ratios = [
        statistics.median(raw[start : start + slices])
        / statistics.median(kept[start : start + slices])
        for start in starts
    ]
    print(
        f"{len(data) / 1e3:8.0f} kB a slice   raw {1.0 / statistics.median(raw):7.1f} /s"
        f"   kept {1.0 / statistics.median(kept):7.1f} /s   ratio {statistics.median(ratios):.0%}"
        f" ({min(ratios):.0%} to {max(ratios):.0%}, {rounds} rounds of {slices})",
        flush=True,
    )
    shutil.rmtree(folder)
    folder.mkdir()


def memory(folder: Path, many: int) -> None:
    """Print a line: what is resident in the course of a long scan."""
    taken = sweep(0, *_SMALL)
    resident_mb = []
    with ScanFolder.create(folder / "long.scan", record(many)) as writer:
        for tenth in range(10):
            for index in range(tenth * many // 10, (tenth + 1) * many // 10):
                writer.append(replace(taken, index=index))
            resident_mb.append(_resident_mb())
        writer.finish(State.COMPLETE)
    told = " ".join(f"{each:.1f}" for each in resident_mb)
    growth_mb = resident_mb[-1] - resident_mb[0]
    print(f"{many} slices: {told} MB resident; {growth_mb:+.2f} MB from the first tenth on")


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path.cwd(), help="on the disk to measure")
    parser.add_argument("--slices", type=int, default=50)
    parser.add_argument("--many", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=7)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=chosen.folder, prefix=".recording-") as place:
        folder = Path(place) / "here"
        folder.mkdir()
        for size in _SIZES:
            rates(folder, size, chosen.slices, chosen.rounds)
        memory(folder, chosen.many)


if __name__ == "__main__":
    main()
