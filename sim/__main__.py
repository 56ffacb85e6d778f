"""``python -m sim``: a simulated station on wires of this machine, until Ctrl-C.

A parent that starts it waits for the line ``station: PATH``, or for a JSON object with ``--json``;
with ``--while-stdin-open`` it ends when the parent does, however that ends. ``kill -USR1`` pulls a
cable, which is put back by itself (``away-ms`` of ``--faults``).
"""

from __future__ import annotations

import argparse
import fcntl
import json
import math
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NoReturn

from sim.artefacts import ARTEFACTS, CERTIFICATES
from sim.axes import StageFamily, TableFamily
from sim.cabling import Cabling
from sim.crooked import Crookedness
from sim.cuts import Cut, mounting_for
from sim.faults import FAULTS, Speaker, parse_faults
from sim.lasers import LaserWiring
from sim.parts import PARTS, find_part
from sim.port_names import vanishing
from sim.profilers import ProfilerFamily
from sim.relay import Contact
from sim.sensor_clock import SensorClock
from sim.serving import Ending, Server
from sim.solids import Part
from sim.stations import (
    PLAN_RINGS,
    PLAN_STOPS,
    Devices,
    Layout,
    build,
    connect,
    plan_toml,
    station_toml,
    truth_ply,
    turning_plan_toml,
)
from sim.witness import WitnessLog

_DONE, _FAILED, _BAD_USAGE = 0, 1, 2
_TURNING_DEG_S = 60.0  # of a plan with --continuous
_STEADY = {  # who can be measured while it turns, or measures so
    "cut": (Cut.RINGS.value,),
    "profiler": (ProfilerFamily.BAUMER_OX.value, ProfilerFamily.RIFTEK.value),
    "table": (TableFamily.GRBL.value, TableFamily.GRBLHAL.value),
}


@dataclass(frozen=True, slots=True)
class _Files:
    """What is written before the first byte is served."""

    station: Path
    plan: Path
    truth: Path
    witness: Path


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    wanted = _parser().parse_args(words)
    if wanted.list:
        sys.stdout.write(_listing())
        return _DONE
    ending = Ending()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, ending.ask)
    try:
        with (
            TemporaryDirectory(prefix="loftscan-sim-") as folder,
            vanishing(Path(folder)),
            _claimed((wanted.out or Path(folder)).resolve()),
        ):
            _serve(wanted, Path(folder), ending)
    except ValueError as wrong:
        sys.stderr.write(f"sim: {wrong}\n")
        return _BAD_USAGE
    except OSError as failure:
        sys.stderr.write(f"sim: {failure}\n")
        return _FAILED
    return _DONE


def _serve(wanted: argparse.Namespace, folder: Path, ending: Ending) -> None:
    """Build the station, put it on wires named in a folder, write the files, and serve."""
    _check_continuous(wanted)
    faults, part = parse_faults(wanted.faults), find_part(wanted.part)
    layout = Layout(
        seed=wanted.seed,
        time_scale=wanted.scale,
        cloud_width_mm=wanted.cloud_width_mm,
        outlier_rate=wanted.outliers,
        table_family=TableFamily(wanted.table),
        stage_family=StageFamily(wanted.stage),
        profiler_family=ProfilerFamily(wanted.profiler),
        laser=_laser_of(wanted),
        cut=Cut(wanted.cut),
        mounting=mounting_for(Cut(wanted.cut), part),
        rate_hz=wanted.rate_hz,
        sensor_clock=_sensor_clock(wanted),
        crooked=Crookedness() if wanted.crooked else None,
    )
    files = _files(wanted, folder)
    with WitnessLog(files.witness) as witness:
        devices = build(layout, part, witness, time.monotonic(), faults=faults)
        cabling = Cabling(faults, layout.seed, witness)
        signal.signal(signal.SIGUSR1, lambda *_: cabling.pull_any(time.monotonic()))
        with Server(lively=devices.lively) as server:
            addresses = connect(devices, layout, cabling, server, folder)
            files.truth.write_bytes(truth_ply(part))
            plan = _plan(wanted, layout, part)
            files.plan.write_text(plan, encoding="utf-8")
            files.station.write_text(station_toml(layout, addresses, part.name), encoding="utf-8")
            if part.name in CERTIFICATES:
                certificate = files.station.with_name("artefact.toml")
                certificate.write_text(CERTIFICATES[part.name](), encoding="utf-8")
            if wanted.while_stdin_open:
                _end_with_stdin(server, ending, devices, cabling)
            _tell(files, as_json=wanted.json)
            server.run(ending)


def _check_continuous(wanted: argparse.Namespace) -> None:
    """Refuse a plan of steady turning where the simulated devices, or the slices, are others'."""
    for name, able in _STEADY.items():
        if wanted.continuous and getattr(wanted, name) not in able:
            raise ValueError(
                f"--continuous: not with --{name} {getattr(wanted, name)}; use --{name}"
                f" {' or '.join(able)}, or leave it out"
            )


def _plan(wanted: argparse.Namespace, layout: Layout, part: Part) -> str:
    if not wanted.continuous:
        return plan_toml(layout, part, rings=wanted.rings, stops=wanted.stops or PLAN_STOPS)
    turn = wanted.stops or math.ceil(360.0 * layout.rate_hz / _TURNING_DEG_S)
    return turning_plan_toml(layout, part, rings=wanted.rings, profiles_per_turn=turn)


def _sensor_clock(wanted: argparse.Namespace) -> SensorClock | None:
    """A clock of the sensor's own, where anybody asked for one or for more than it usually does."""
    latency_ms, drift_ppm = wanted.sensor_latency_ms, wanted.sensor_drift_ppm
    if not (latency_ms or drift_ppm or wanted.continuous) and wanted.rate_hz <= Layout().rate_hz:
        return None
    started_s = random.Random(f"{wanted.seed} clock").uniform(10.0, 1e5)
    return SensorClock(latency_s=latency_ms / 1e3, drift_ppm=drift_ppm, started_s=started_s)


def _laser_of(wanted: argparse.Namespace) -> LaserWiring:
    """What switches the laser: where nobody chose, a Hokuyo its own, of others an I/O block."""
    if wanted.laser is not None:
        return LaserWiring(wanted.laser)
    own = wanted.profiler == ProfilerFamily.HOKUYO.value
    return LaserWiring.HOKUYO if own else Layout().laser


def _files(wanted: argparse.Namespace, folder: Path) -> _Files:
    """Where everything goes; what an earlier run witnessed there is forgotten."""
    out = (wanted.out or folder).resolve()
    witness = (wanted.witness or out / "witness.jsonl").resolve()
    witness.write_bytes(b"")
    station = (wanted.station or out / "station.toml").resolve()
    return _Files(station, out / "plan.toml", out / "truth.ply", witness)


@contextmanager
def _claimed(out: Path) -> Iterator[None]:
    """Keep a folder to this simulator: its files name this one's ports."""
    out.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(out, os.O_RDONLY)
    try:
        _lock(descriptor, out)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, out: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ValueError(
            f"--out: {out}: another simulator serves from there; end it, or name another folder"
        ) from None


def _end_with_stdin(server: Server, ending: Ending, devices: Devices, cabling: Cabling) -> None:
    """End with whoever holds the pipe.

    On it ``press estop``, ``release estop``, and the same of interlock and key, are done; and
    ``pull cable``, ``plug cable``: the one of what switches the laser, mute then and not lost.
    ``unplug table stage`` pulls the cables of these together; they are put back by themselves.
    """
    whole = devices.laser_cable.answers

    def heed(line: str) -> None:
        verb, _, name = line.strip().partition(" ")
        contact = Contact.__members__.get(name.upper())
        if contact is not None and verb in ("press", "release"):
            (devices.relay.press if verb == "press" else devices.relay.release)(contact)
        elif verb == "unplug":
            wires = [speaker for speaker in Speaker if speaker.value in name.split()]
            cabling.pull(*wires, now_s=time.monotonic())
        elif name == "cable" and verb in ("pull", "plug"):
            devices.laser_cable.answers = 0 if verb == "pull" else whole

    try:
        server.end_with(0, ending, heed)
    except PermissionError as file:
        raise ValueError(
            "--while-stdin-open: stdin is a file, which stays open; give a pipe"
        ) from file


def _tell(files: _Files, *, as_json: bool) -> None:
    told = {name: str(getattr(files, name)) for name in ("station", "plan", "truth", "witness")}
    line = json.dumps({**told, "pid": os.getpid()}) if as_json else f"station: {files.station}"
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _listing() -> str:
    faults = (f"  {name:20} {meaning}\n" for name, meaning in FAULTS.items())
    known = ", ".join((*PARTS, *ARTEFACTS))
    return f"parts: {known}, or a mesh file\nfaults:\n{''.join(faults)}"


def _count_from(least: int) -> Callable[[str], int]:
    def count(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r}: a count of {least} or more is expected")
        return int(text)

    return count


class _OneLineParser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(_BAD_USAGE, f"{self.prog}: {message}; see --help\n")


def _parser() -> argparse.ArgumentParser:
    normal = Layout()
    parser = _OneLineParser("sim", description="A simulated scanning station on real wires.")
    option = parser.add_argument
    option("--part", default="vase", metavar="NAME or MESH", help="what stands on the table")
    option("--seed", type=int, default=normal.seed, help="of all that is random")
    option("--scale", type=float, default=normal.time_scale, help="how much faster its time runs")
    option("--cloud-width-mm", type=float, default=normal.cloud_width_mm, help="of the noise")
    option("--outliers", type=float, default=normal.outlier_rate, help="share of the points")
    for role, families in (("table", TableFamily), ("stage", StageFamily)):
        names = [each.value for each in families]
        default = getattr(normal, f"{role}_family").value
        option(f"--{role}", choices=names, default=default, help="family of that axis")
    profilers = [each.value for each in ProfilerFamily]
    default = normal.profiler_family.value
    option("--profiler", choices=profilers, default=default, help="family of what measures")
    cuts = [each.value for each in Cut]
    option("--cut", choices=cuts, default=normal.cut.value, help="what the station's slices are")
    option("--rate-hz", type=float, default=normal.rate_hz, help="of a profiler that streams")
    option("--sensor-latency-ms", type=float, default=0.0, help="from the light to its time stamp")
    option("--sensor-drift-ppm", type=float, default=0.0, help="how fast its clock is")
    option("--rings", type=_count_from(1), default=PLAN_RINGS, help="slices of plan.toml")
    option("--stops", type=_count_from(3), help="of the table, in each ring")
    option("--continuous", action="store_true", help="plan.toml turns steadily; keep --scale 1")
    option("--faults", default="", metavar="NAME,NAME=N", help="what is wrong; --list names all")
    wirings = [each.value for each in LaserWiring]
    option("--laser", choices=wirings, help="what switches it; absent: turck, a hokuyo its own")
    option("--crooked", action="store_true", help="stands otherwise than station.toml says")
    option("--out", type=Path, metavar="DIR", help="keeps the files; absent: gone at the end")
    option("--station", type=Path, metavar="FILE", help="for station.toml alone")
    option("--witness", type=Path, metavar="FILE", help="for the log of what truly happened alone")
    option("--json", action="store_true", help="names every file in one line of JSON")
    option("--while-stdin-open", action="store_true", help="ends when stdin is closed")
    option("--list", action="store_true", help="names the parts and the faults")
    return parser


if __name__ == "__main__":
    sys.exit(main())
