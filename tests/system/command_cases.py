"""A part whose truth is a formula, and the program as a person runs it, for whole-program tests."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from typer.testing import CliRunner
from typer.testing import Result as Ran

from loftscan.cli import app

FloatArray = NDArray[np.float64]

ROW_MM = 2.0
HEIGHT_MM = 30.0
NOISE_MM = 0.05
ROWS, STEPS = 16, 240
SHADOWED_ROWS, SHADOW_RAD = 3, 0.7
STRAYS, INVALID = 6, 5

# What DESIGN promises of every result folder that is written with all formats.
RESULT_FILES = {
    "surface.json", "surface.step", "surface.3dm", "mesh.stl", "mesh.stl.unit.txt", "mesh.ply",
    "mesh.glb", "sections.json", "metrics.json", "report.html", "provenance.json",
}  # fmt: skip


def radius_mm(angle_rad: FloatArray, height_mm: FloatArray) -> FloatArray:
    """An oval foot, and from half its height a thinner round neck: two runs of sections."""
    return np.where(height_mm < HEIGHT_MM / 2, 20.0 + 2.0 * np.cos(2.0 * angle_rad), 13.0)


def volume_mm3() -> float:
    """Of the body whose rows are joined by straight lines, from integrals and not from meshes."""
    foot, neck = math.pi * (20.0**2 + 2.0**2 / 2.0), math.pi * 13.0**2
    angles = np.arange(3600) * math.tau / 3600
    low, high = radius_mm(angles, np.zeros(3600)), radius_mm(angles, np.full(3600, HEIGHT_MM))
    step = math.pi * float(np.mean(low**2 + low * high + high**2)) / 3.0
    return 14.0 * foot + ROW_MM * step + 14.0 * neck


def scanned_part(seed: int = 7) -> FloatArray:
    """Its scan, row by row, axis z: radial noise, one shadow, a few strays, (n, 3) in mm."""
    rng = np.random.default_rng(seed)
    rows, turn = np.arange(ROWS) * ROW_MM, np.arange(STEPS) * (math.tau / STEPS)
    angle, height = (grid.ravel() for grid in np.meshgrid(turn, rows))
    shadow = (height >= 4.0) & (height <= 8.0) & (np.abs(angle - 2.0) < SHADOW_RAD / 2)
    angle, height = angle[~shadow], height[~shadow]
    radius = radius_mm(angle, height) + rng.normal(0.0, NOISE_MM, len(angle))
    part = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    around = rng.uniform(0.0, math.tau, STRAYS)
    lost = [60.0 * np.cos(around), 60.0 * np.sin(around), rng.uniform(0.0, HEIGHT_MM, STRAYS)]
    return np.concatenate([part, np.column_stack(lost)])


def write_cloud(path: Path, points: FloatArray) -> Path:
    """As .npy, which keeps every bit, or as text that reads back to the same numbers."""
    if path.suffix == ".npy":
        np.save(path, points)
    else:
        np.savetxt(path, points, fmt="%.17g")
    return path


def run(*arguments: object) -> Ran:
    """A command in this process."""
    return CliRunner().invoke(app, [str(each) for each in arguments])


def start(*arguments: object, cwd: Path | None = None) -> subprocess.Popen[str]:
    """A command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "loftscan.cli", *map(str, arguments)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=cwd,
    )  # fmt: skip


def succeeded(ran: Ran) -> Ran:
    """The run, if it ended well."""
    assert ran.exit_code == 0, ran.output
    return ran


def complaint(ran: Ran, code: int) -> str:
    """The one line that a person reads when a command fails with this exit code."""
    assert isinstance(ran.exception, SystemExit), f"a traceback: {ran.exception!r}"
    assert ran.exit_code == code, ran.output
    assert ran.stdout == ""
    lines = ran.stderr.splitlines()
    assert len(lines) == 1, ran.stderr
    assert lines[0].startswith("loftscan: ")
    # Python's own words are no message to an operator.
    assert not re.search(r"Traceback|Error\b|Errno|<class|0x[0-9a-f]{6}|\.partial", lines[0])
    return lines[0].removeprefix("loftscan: ")


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything under a folder, hidden or not: bytes of files, None for folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }
