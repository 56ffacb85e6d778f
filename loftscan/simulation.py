"""The verb `simulate`: a simulated station in a process of its own, reached as hardware is.

    >>> with simulate(part="vase") as simulated, Station.open(simulated) as station:
    ...     station.home()

The simulator ends with the block, and by itself when this program dies: it watches a pipe. It does
not hear the terminal's Ctrl-C, which is for the program that uses it.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal

_START_S = 180.0  # the first start on a machine compiles
_END_S = 5.0


@dataclass(frozen=True, slots=True)
class Simulated:
    """A simulated station that is live; a path of its station.toml by itself."""

    station: Path
    plan: Path  # that suits the part
    truth: Path  # mesh of the part
    witness: Path  # what truly happened, a line an event
    pid: int
    hands: IO[str] | None = field(default=None, compare=False, repr=False)  # of the operator

    def press(self, contact: Literal["estop", "interlock", "key"]) -> None:
        """Press the emergency stop, open the interlock, turn the key off."""
        self._do(f"press {contact}")

    def release(self, contact: Literal["estop", "interlock", "key"]) -> None:
        """Undo `press`."""
        self._do(f"release {contact}")

    def pull_the_lasers_cable(self) -> None:
        """Nothing that is said to what switches the laser arrives any more."""
        self._do("pull cable")

    def plug_the_lasers_cable(self) -> None:
        """It arrives again."""
        self._do("plug cable")

    def unplug(self, *wires: Literal["table", "stage", "profiler", "relay"]) -> None:
        """Pull these cables together: the links are lost; they are back by themselves.

        After half a second, or the time that ``faults="away-ms=MS"`` says.
        """
        self._do(f"unplug {' '.join(wires)}")

    def _do(self, what: str) -> None:
        hands = _pipe(self.hands)
        hands.write(f"{what}\n")
        hands.flush()

    def __fspath__(self) -> str:
        return str(self.station)

    def __str__(self) -> str:
        return str(self.station)


@contextmanager
def simulate(
    part: str = "vase",
    *,
    seed: int | None = None,
    scale: float | None = None,
    cloud_width_mm: float | None = None,
    outliers: float | None = None,
    rings: int | None = None,
    stops: int | None = None,
    cut: str | None = None,
    table: str | None = None,
    stage: str | None = None,
    profiler: str | None = None,
    faults: str | Sequence[str] = (),
    laser: str | None = None,
    crooked: bool = False,
    out: str | os.PathLike[str] | None = None,
) -> Iterator[Simulated]:
    """Serve a simulated station while the block lasts.

    Parameters
    ----------
    part
        A part by name, or a mesh file.
    seed, scale, cloud_width_mm, outliers
        Of the noise; how much faster than real time; of the optics: by default the simulator's.
    rings, stops
        Of the plan: how many rings (or other slices), and how many stops of the table in each.
    cut
        What the station's slices are: ``"rings"`` by default, ``"meridians"`` or ``"stripes"``.
    table, stage
        Families of the axes, such as ``table="oriental"``; by default grbl and leadshine.
    profiler
        Family of what measures: ``"baumer_ox"`` by default, ``"riftek"``, ``"registers"``,
        ``"hokuyo"`` (which lights its own laser) or ``"sick"``.
    faults
        Planted faults by name, such as ``"no-profiles"``.
    laser
        What switches the laser: ``"turck"`` by default, ``"plain"``, ``"grbl"``, ``"none"`` and
        others; `loftscan sim --help` has them.
    crooked
        It stands otherwise than its station.toml says (axis tilted and aside, table scale 3 % off,
        sheet yawed), so that it must be calibrated.
    out
        Where its files go; by default a folder that goes with the block.

    Raises
    ------
    ValueError
        The simulator does not know the part, or did not start; says what it said.
    """
    planted = faults if isinstance(faults, str) else ",".join(faults)
    options = {
        "--part": part, "--seed": seed, "--scale": scale, "--cloud-width-mm": cloud_width_mm,
        "--outliers": outliers, "--rings": rings, "--stops": stops, "--faults": planted or None,
        "--table": table, "--stage": stage, "--profiler": profiler,
        "--laser": laser, "--cut": cut,
    }  # fmt: skip
    chosen = [each for name, value in options.items() if value is not None
              for each in (name, str(value))]  # fmt: skip
    chosen += ["--crooked"] if crooked else []
    with tempfile.TemporaryDirectory(prefix="loftscan-sim-") as own:
        said = Path(own) / "said.txt"
        with said.open("wb") as errors:
            process = _started([*chosen, "--out", str(out or own)], errors)
        with process:
            try:
                yield _told(process, said)
            finally:
                _end(process)


def simulator_command(options: Sequence[str]) -> list[str]:
    """Give the command line of the simulator; a ``sim`` in the current folder is not it."""
    return [sys.executable, "-P", "-m", "sim", *options]


def _started(options: Sequence[str], errors: IO[bytes]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        simulator_command([*options, "--json", "--while-stdin-open"]),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,  # a file: nobody empties a pipe while the station is in use
        text=True,
        start_new_session=True,
    )


def _told(process: subprocess.Popen[str], said: Path) -> Simulated:
    """Wait for the line that says that all wires are listening."""
    pipe = _pipe(process.stdout)
    ready, _, _ = select.select([pipe], [], [], _START_S)
    line = pipe.readline() if ready else ""
    if not line:
        process.kill()
        lines = said.read_text(errors="replace").strip().splitlines()
        raise ValueError(lines[-1] if lines else f"simulator: did not start in {_START_S:g} s")
    told = json.loads(line)
    station, plan, truth, witness = (
        Path(told[name]) for name in ("station", "plan", "truth", "witness")
    )
    return Simulated(station, plan, truth, witness, int(told["pid"]), process.stdin)


def _end(process: subprocess.Popen[str]) -> None:
    _pipe(process.stdin).close()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()


def _pipe(pipe: IO[str] | None) -> IO[str]:
    if pipe is None:
        raise ValueError("simulator: started without its pipes")
    return pipe
