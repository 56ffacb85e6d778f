"""Nanoseconds a point, and memory, for reading a cloud of each format.

Run it: ``python -m benchmarks.reading [POINTS]``. Every format is read five times in a process of
its own, after one reading that compiles the kernels and warms the disk cache; the median is
printed, with the peak memory of that process: in all, and above what it was before the first
reading (the compiled code and one chunk of 2**20 points, 24 MB, included). Linux only: /proc.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from reconstruction.clouds import open_cloud

RUNS = 5


def write_samples(folder: Path, count: int) -> dict[str, Path]:
    """Write the same points in every format; returns their paths by what they are."""
    points = np.random.default_rng(1).normal(0, 50, (count, 3)).astype("<f4")
    text = {"6 decimals": "%.6f", "9 digits": "%.9g", "19 digits": "%.18e"}
    samples = {}
    for name, form in text.items():
        samples[f"xyz, {name}"] = folder / f"{name.replace(' ', '_')}.xyz"
        np.savetxt(samples[f"xyz, {name}"], points, fmt=form)
    samples["csv, header"] = folder / "named.csv"
    np.savetxt(samples["csv, header"], points, "%.6f", ",", header="x,y,z", comments="")
    ply = "ply\nformat {} 1.0\nelement vertex {}\n" + "".join(
        f"property float {a}\n" for a in "xyz"
    )
    for encoding, order in (("binary_little_endian", "<f4"), ("binary_big_endian", ">f4")):
        samples[f"ply {encoding}"] = folder / f"{encoding}.ply"
        body = points.astype(order).tobytes()
        _write(samples[f"ply {encoding}"], ply.format(encoding, count) + "end_header\n", body)
    pcd = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {count}\nHEIGHT 1\nDATA "
    samples["pcd binary_compressed"] = folder / "compressed.pcd"
    body = _literal_lzf(np.ascontiguousarray(points.T).tobytes())
    _write(samples["pcd binary_compressed"], pcd + "binary_compressed\n", body)
    for order in "CF":
        samples[f"npy, {order} order"] = folder / f"{order}.npy"
        np.save(samples[f"npy, {order} order"], np.asarray(points, order=order))
    return samples


def measure(path: Path) -> tuple[float, float, float]:
    """Median seconds of a pass, the peak memory in MB, and how far it rose."""
    before = _memory_mb("VmRSS")
    seconds = []
    for _ in range(1 + RUNS):
        start = time.perf_counter()
        for _chunk in open_cloud(path).chunks():
            pass
        seconds.append(time.perf_counter() - start)
    peak = _memory_mb("VmHWM")
    return statistics.median(seconds[1:]), peak, peak - before


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    print(f"{count} points, median of {RUNS}")
    print(f"{'':26}{'ns/point':>10}{'MB/s':>8}{'peak MB':>9}{'rise':>6}")
    with tempfile.TemporaryDirectory() as folder:
        for name, path in write_samples(Path(folder), count).items():
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
                seconds, peak, rise = fresh.submit(measure, path).result()
            speed = path.stat().st_size / 1e6 / seconds
            print(f"{name:26}{seconds / count * 1e9:10.0f}{speed:8.0f}{peak:9.0f}{rise:6.0f}")


def _memory_mb(name: str) -> float:
    # ru_maxrss would not do: a child inherits its parent's.
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024


def _write(path: Path, header: str, body: bytes) -> None:
    path.write_bytes(header.encode() + body)


def _literal_lzf(data: bytes) -> bytes:
    """LZF in its plainest form, 32 literal bytes an instruction: noise does not compress."""
    padded = np.frombuffer(data + bytes(-len(data) % 32), np.uint8).reshape(-1, 32)
    runs = np.hstack([np.full((len(padded), 1), 31, np.uint8), padded])
    tail = runs[-1, : 1 + (len(data) - 1) % 32 + 1].copy()
    tail[0] = len(tail) - 2
    packed = runs[:-1].tobytes() + tail.tobytes()
    return len(packed).to_bytes(4, "little") + len(data).to_bytes(4, "little") + packed


if __name__ == "__main__":
    main()
