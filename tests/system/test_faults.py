"""What an operator reads when something is wrong, each fault on the real wires.

One line that says what to do, the right exit code, and nothing lost that was told to be kept. The
lines are those of docs/messages.md, numbers and names aside, and the page has no title unsaid.
"""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from acquisition.calibration import write_calibration
from acquisition.errors import LeaseLapsed
from acquisition.plan import Plan, StepAndShoot, ring, write_plan
from acquisition.poses import Sweep
from acquisition.scan_record import ScanRecord, State
from acquisition.scanfile import ScanFolder
from acquisition.station import read_station
from drivers.errors import DriverError
from drivers.profiler import Profile, Reason
from loftscan import Station, simulate
from loftscan.simulation import Simulated
from sim.artefacts import ball_plate, ball_plate_toml
from sim.crooked import Crookedness
from tests.acquisition.test_calibration import calibration
from tests.campaigns.crooked_chain import taken
from tests.loftscan.made_scans import damage, sweeps, write_scan
from tests.loftscan.test_following import ENDS
from tests.system.command_cases import run, start, succeeded

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "docs/messages.md").read_text(encoding="utf-8")
SEED, SCALE = 3, 20.0
PATIENCE_S = 60.0  # for a machine that does a lot else

# -- the page --------------------------------------------------------------------------------------

ENTRIES = {
    title: (words, int(code))
    for title, words, code in re.findall(
        r"^### (.+)\n\n> (.+)\n\nExit code (\d)\. ", PAGE, re.MULTILINE
    )
}
FOLLOWING = re.findall(r"^- `(.+)`$", PAGE.partition("## What may follow")[2], re.MULTILINE)
_VARIES = (
    (r"(?:serial|tcp|udp)://[^\s;()]*[^\s;():,]", "ADDRESS"),
    (r"[\w./-]*\.(?:toml|scan|npz)(?:\.damaged)?\b|\b(?:STATION|PLAN)\.toml", "FILE"),
    (r"process \d+ \(.*\);", "process N (COMMAND);"),
    (r"tries \(.*?\): press", "tries (REASON): press"),
    (r"over a new one \(.*?\): press", "over a new one (REASON): press"),
    (r"set aside \(.*\); the", "set aside (REASON); the"),
    (r"left out \(.*?\): `", "left out (REASON): `"),
    (r"(no connection|is gone) \((.*?)\);", r"\1 (REASON);"),
    (r"\b[0-9a-f]{2}(?: [0-9a-f]{2})+\b", "BYTES"),
    (r"\b0x[0-9a-fA-F]+", "0xN"),
    (r"(?<![\w])\d+(?:\.\d+)?(?![\w.])", "N"),
)


def plain(line: str) -> str:
    """A line without what differs from run to run."""
    for pattern, name in _VARIES:
        line = re.sub(pattern, name, line)
    return line


def assert_told(line: str, code: int, *titles: str) -> None:
    """The line is that of one of these titles, with what may follow, and so is the exit code."""
    rest = plain(line)
    said = [title for title in titles if rest.startswith(ENTRIES[title][0])]
    assert said, rest
    words, due = ENTRIES[said[0]]
    assert code == due
    rest = rest.removeprefix(words)
    known = sorted([*FOLLOWING, *(words for words, _ in ENTRIES.values())], key=len, reverse=True)
    while rest:
        after = next((each for each in known if rest.startswith(f"; {each}")), None)
        assert after is not None, rest
        rest = rest.removeprefix(f"; {after}")


def test_every_message_of_the_page_is_said_in_a_test() -> None:
    assert len(ENTRIES) == PAGE.count("\n### ")
    assert len(FOLLOWING) >= 3
    tests = Path(__file__).read_text(encoding="utf-8")
    assert [title for title in ENTRIES if f'"{title}"' not in tests] == []


# -- scans -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ended:
    """How a scan ended: its exit code, its one line, and the slices that it told to be kept."""

    code: int
    line: str
    told: tuple[int, ...]


@pytest.fixture(scope="module")
def station() -> Iterator[Simulated]:
    with simulate(seed=SEED, scale=SCALE) as simulated:
        yield simulated


@pytest.fixture(scope="module")
def sound(station: Simulated, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scan as it is without a fault."""
    place = tmp_path_factory.mktemp("sound")
    write_rings(place / "plan.toml", 2)
    out = place / "part.scan"
    succeeded(run("scan", station, place / "plan.toml", "--out", out))
    return out


@pytest.fixture
def plan(place: Path) -> str:
    """Two rings of three stops in the lower part of the vase, 10 and 12 mm up the stage."""
    write_rings(place / "plan.toml", 2)
    return "plan.toml"


def write_rings(file: Path, count: int) -> None:
    rings = ring(10.0, 10.0 + 2.0 * (count - 1), 2.0, 3).ring
    file.write_text(write_plan(Plan(ring=rings, step_and_shoot=StepAndShoot(settle_s=0.0))))


def scan(station: object, plan: str, *options: object) -> Ended:
    ran = run("scan", station, plan, "--out", "part.scan", "--json", *options)
    assert isinstance(ran.exception, SystemExit | None), repr(ran.exception)
    return ended(ran.exit_code, ran.stdout, ran.stderr)


def ended(code: int, stdout: str, stderr: str) -> Ended:
    # A guard that found the laser not seen to be off says so, after the program's own line.
    stderr = "".join(
        line for line in stderr.splitlines(keepends=True) if not line.startswith("loftscan guard: ")
    )
    assert stderr.count("\n") == (code != 0), stderr
    assert "Traceback" not in stderr
    events = map(json.loads, stdout.splitlines())
    told = tuple(event["index"] for event in events if event["event"] == "slice")
    return Ended(code, stderr.removeprefix("loftscan: ").rstrip("\n"), told)


def assert_nothing_lost(end: Ended, out: str = "part.scan") -> None:
    found = ScanFolder.open(Path(out)).verify()
    assert found.damaged == ()
    assert set(end.told) <= set(found.sound)
    assert f"{len(found.sound)} of " in end.line
    assert "slices are kept, go on with: loftscan scan" in end.line


def assert_dark(station: Simulated) -> None:
    """The laser is off, and nothing was set in motion while it was on."""
    lit = False
    for event in map(json.loads, station.witness.read_text().splitlines()):
        lit = event["on"] if event["what"] == "laser" else lit
        assert not (lit and event["what"] == "move")
    assert not lit


def assert_kept_as(sound: Path, end: Ended) -> None:
    """Every slice that was told to be kept is what it is without the fault."""
    for index in end.told:
        assert_same_measurement(
            ScanFolder(Path("part.scan")).read(index), ScanFolder(sound).read(index)
        )


def assert_same_measurement(sweep: Sweep, other: Sweep) -> None:
    """The same points at the same poses, but for points that are marked as lost."""
    assert [(each.table_rad, each.stage_mm) for each in sweep.poses] == [
        (each.table_rad, each.stage_mm) for each in other.poses
    ]
    for one, two in zip(sweep.profiles, other.profiles, strict=True):
        there = one.reasons != Reason.LOST
        for name in ("counts", "reasons", "intensity"):
            np.testing.assert_array_equal(getattr(one, name)[there], getattr(two, name)[there])


def changed(station: Simulated, old: str, new: str) -> str:
    """A station file like the live one, one text of it replaced."""
    before = station.station.read_text()
    text = re.sub(old, new, before)
    assert text != before
    Path("changed.toml").write_text(text)
    return "changed.toml"


@contextmanager
def scanning(station: Simulated, out: str) -> Iterator[subprocess.Popen[str]]:
    """A scan in a process of its own, when its first slice is told to be kept.

    It has more rings than it can take before a machine that does a lot else has planted a fault.
    """
    write_rings(Path("long.toml"), 20)
    child = start("scan", station, "long.toml", "--out", out, "--json")
    try:
        assert child.stdout is not None
        while '"slice"' not in (line := child.stdout.readline()):
            assert line, child.communicate()
        yield child
    finally:
        child.kill()
        child.communicate()


def end_of(child: subprocess.Popen[str]) -> Ended:
    stdout, stderr = child.communicate(timeout=PATIENCE_S)
    end = ended(child.returncode, stdout, stderr)
    return Ended(end.code, end.line, (0, *end.told))


# -- devices ---------------------------------------------------------------------------------------


@pytest.fixture
def without_boot_loader(monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulated controller needs no 2 s to start, so nobody waits that long for a dead one."""
    monkeypatch.setattr("drivers.grbl.axis.BANNER_S", 0.3)


@pytest.mark.parametrize(
    ("device", "title"),
    [
        ("table", "The table does not answer"),
        ("stage", "The stage does not answer"),
        ("profiler", "The profiler does not answer"),
        ("relay", "The laser's switch does not answer"),
    ],
)
def test_a_device_that_does_not_answer(
    place: Path, plan: str, without_boot_loader: None, device: str, title: str
) -> None:
    with simulate(seed=SEED, scale=SCALE, faults=f"silent-{device}") as station:
        end = scan(station, plan)
        assert_told(end.line, end.code, title)
        assert not Path("part.scan").exists()
        assert_dark(station)


def test_an_emergency_stop_that_is_pressed_already(place: Path, plan: str) -> None:
    with simulate(seed=SEED, scale=SCALE) as station:
        station.press("estop")
        end = scan(station, plan)
        assert_told(end.line, end.code, "The emergency stop is pressed")
        assert not Path("part.scan").exists()
        assert_dark(station)
        station.release("estop")
        succeeded(run("scan", station, plan, "--out", "part.scan"))


@pytest.mark.parametrize("laser", ["plain", "grbl", "timed", "hokuyo", "none"])
def test_a_laser_that_only_a_person_could_turn_off_is_not_lit_for_nobody(
    place: Path, plan: str, laser: str
) -> None:
    profiler = "hokuyo" if laser == "hokuyo" else None
    with simulate(seed=SEED, scale=SCALE, laser=laser, profiler=profiler) as station:
        end = scan(station, plan)
        titles = {
            "plain": "Nobody is there to press the emergency stop",
            "grbl": "Nobody is there, and a Grbl board switches the laser",
            "timed": "Nobody is there, and a timed relay switches the laser",
            "hokuyo": "Nobody is there, and a scanner switches its own laser",
            "none": "Nobody is there, and nothing switches the laser",
        }
        assert_told(end.line, end.code, titles[laser])
        if laser != "none":
            assert_dark(station)
        ran = run("scan", station, plan, "--out", "part.scan", "--attended")
        succeeded(ran)
        assert "guard: " in ran.stdout


def test_a_guard_that_does_not_live_lets_nothing_be_lit(
    station: Simulated, place: Path, plan: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("acquisition.safety.guarding.sys.executable", "/bin/false")
    end = scan(station, plan)
    assert_told(end.line, end.code, "The guard does not live")
    assert not Path("part.scan").exists()


def test_a_port_that_does_not_exist(station: Simulated, place: Path, plan: str) -> None:
    end = scan(changed(station, r"serial://\S+/stage\?", "serial:///dev/nowhere?"), plan)
    assert_told(end.line, end.code, "There is no such port")
    assert "/dev/nowhere" in end.line
    assert not Path("part.scan").exists()


def test_an_address_where_nobody_listens(station: Simulated, place: Path, plan: str) -> None:
    address = read_station(station.station).profiler.address
    end = scan(changed(station, re.escape(address), "tcp://127.0.0.1:1"), plan)
    assert_told(end.line, end.code, "Nobody listens at an address")
    assert "tcp://127.0.0.1:1" in end.line


HOLD = """
import sys
from drivers.links import open_link
link = open_link(sys.argv[1])
print("held", flush=True)
sys.stdin.read()
"""


def test_a_port_that_another_process_holds(station: Simulated, place: Path, plan: str) -> None:
    address = read_station(station.station).stage.address
    words = [sys.executable, "-c", HOLD, address]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        end = scan(station, plan)
        holder.communicate("", timeout=PATIENCE_S)
    assert_told(end.line, end.code, "Another program holds the port")
    assert f"held by process {holder.pid} (" in end.line
    assert not Path("part.scan").exists()


def test_a_profiler_that_sends_nothing(place: Path, plan: str) -> None:
    with simulate(seed=SEED, scale=SCALE, faults="no-profiles") as station:
        end = scan(station, plan)
        assert_told(end.line, end.code, "The profiler sends nothing")
        assert_nothing_lost(end)
        assert_dark(station)


def test_one_dropped_block_in_fifty_is_counted_and_spoils_nothing(
    place: Path, plan: str, sound: Path
) -> None:
    with simulate(seed=SEED, scale=SCALE, faults="drop-blocks=50") as simulated:
        end = scan(simulated, plan)
        assert (end.code, end.told) == (0, (0, 1))
        with Station.open(simulated) as station:
            station.home()
            profiler, deadline_s = station.devices.profiler, time.monotonic() + PATIENCE_S
            while not profiler.tally().torn_profiles:
                assert time.monotonic() < deadline_s
                with suppress(LeaseLapsed), station.lit() as look:  # a busy machine may be late
                    for _ in range(20):
                        look()
    assert_kept_as(sound, end)


def test_of_half_the_datagrams_what_came_is_kept_and_the_rest_is_marked(
    place: Path, plan: str, sound: Path
) -> None:
    with simulate(seed=SEED, scale=SCALE, faults="drop-blocks=2") as station:
        end = scan(station, plan)
    assert (end.code, end.told) == (0, (0, 1))
    assert_kept_as(sound, end)
    reasons = np.concatenate([p.reasons for p in ScanFolder(Path("part.scan")).read(0).profiles])
    assert 0.2 < np.mean(reasons == Reason.LOST) < 0.9
    assert np.mean(reasons == Reason.MEASURED) > 0.1


def test_a_stage_that_stalls(place: Path, plan: str) -> None:
    with simulate(seed=SEED, scale=SCALE, faults="stall-stage=11") as station:
        end = scan(station, plan)
        assert_told(end.line, end.code, "The stage is held")
        assert end.told == (0,)
        assert_nothing_lost(end)
        assert_dark(station)


def test_a_simulator_that_is_killed_amid_a_scan(place: Path) -> None:
    with simulate(seed=SEED, scale=SCALE) as station, scanning(station, "part.scan") as child:
        os.kill(station.pid, signal.SIGKILL)
        end = end_of(child)
    # Who notices first is who was spoken to.
    titles = ("A serial port vanishes", "A connection breaks", "The laser's switch does not answer")
    assert_told(end.line, end.code, *titles)
    assert_nothing_lost(end)


def test_a_line_of_nothing_but_damage(place: Path, plan: str, without_boot_loader: None) -> None:
    with simulate(seed=SEED, scale=SCALE, faults="garbage=1") as station:
        end = scan(station, plan)
        assert_told(end.line, end.code, "A serial line carries nonsense")
        assert not Path("part.scan").exists()
        assert_dark(station)


def test_some_garbage_on_the_wire_is_never_a_wrong_measurement(
    place: Path, plan: str, sound: Path
) -> None:
    with simulate(seed=SEED, scale=SCALE, faults="garbage=9") as station:
        end = scan(station, plan)
        assert_dark(station)
    # Which answer is hit depends on how often was asked: a move whose answer is may be refused.
    assert (end.code, end.told) == (0, (0, 1)) or end.code == 4, end
    assert_kept_as(sound, end)


def test_a_position_is_right_or_not_told_however_the_wire_garbles_it(place: Path) -> None:
    told = []
    with (
        simulate(seed=SEED, scale=SCALE, faults="garbage=3") as simulated,
        Station.open(simulated) as station,
    ):
        for _ in range(16):
            with suppress(DriverError):
                told.append(station.devices.stage.state().position)
    assert set(told) == {0.0}  # where its power came on


# -- calibration -----------------------------------------------------------------------------------


def ruled(station: Simulated) -> str:
    """The live station as if it were a real one, which has to be calibrated."""
    return changed(station, 'kind = "simulated"', 'kind = "nominal"')


def calibrate_to(file: str, days: float = 1.0, **solved: float) -> None:
    """Put a calibration of that station beside it, so old and with such numbers."""
    settings = read_station(Path(file))
    kept = replace(
        calibration(settings, **solved), made=datetime.now(UTC) - timedelta(days=days)
    )  # fmt: skip
    Path("calibration.toml").write_text(write_calibration(kept))


def test_a_station_without_a_calibration(station: Simulated, place: Path, plan: str) -> None:
    end = scan(ruled(station), plan)
    assert_told(end.line, end.code, "There is no calibration")
    assert not Path("part.scan").exists()


def test_a_calibration_that_is_old(station: Simulated, place: Path, plan: str) -> None:
    file = ruled(station)
    calibrate_to(file, days=40.0)
    end = scan(file, plan)
    assert_told(end.line, end.code, "The calibration is old")


def test_a_calibration_of_another_station(station: Simulated, place: Path, plan: str) -> None:
    file = ruled(station)
    calibrate_to(file)
    text = Path(file).read_text()
    Path(file).write_text(re.sub("standoff_mm = .*", "standoff_mm = 226.5", text))
    end = scan(file, plan)
    assert_told(end.line, end.code, "The calibration is another station's")


def test_a_calibration_that_contradicts(station: Simulated, place: Path, plan: str) -> None:
    file = ruled(station)
    calibrate_to(file, table_deg_per_deg=0.5)
    end = scan(file, plan)
    assert_told(end.line, end.code, "The calibration contradicts the station")


@pytest.fixture(scope="module")
def of_balls(station: Simulated, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan of the ball plate by a crooked station, from the simulator's optics, without wires."""
    folder = tmp_path_factory.mktemp("balls")
    text = station.station.read_text().replace('kind = "simulated"', 'kind = "nominal"')
    (folder / "station.toml").write_text(text)
    settings = read_station(folder / "station.toml")
    record = ScanRecord(
        settings, ring(12.0, 72.0, 4.0, 16), settings.kinematics, "loftscan 0", "2026-01-02"
    )
    with ScanFolder.create(folder / "balls.scan", record) as writer:
        for each in taken(ball_plate(), Crookedness(), np.arange(12.0, 74.0, 4.0), 16):
            writer.append(each)
        writer.finish(State.COMPLETE)
    (folder / "artefact.toml").write_text(ball_plate_toml())
    return folder


def calibrate(folder: Path, *options: object) -> tuple[int, str]:
    ran = run(
        "calibrate", folder / "station.toml", folder / "artefact.toml",
        "--scan", folder / "balls.scan", "--out", folder / "calibration.toml", "--json", *options,
    )  # fmt: skip
    return ran.exit_code, ran.stderr.removeprefix("loftscan: ").rstrip("\n")


def test_a_sensor_whose_x_and_z_are_exchanged(of_balls: Path, place: Path) -> None:
    kept = ScanFolder.open(of_balls / "balls.scan")
    with ScanFolder.create(place / "crossed.scan", kept.record()) as writer:
        for index in kept.indices():
            sweep = kept.read(index)
            crossed = [replace(each, counts=each.counts[:, ::-1]) for each in sweep.profiles]
            writer.append(Sweep(index, tuple(crossed), sweep.poses))
        writer.finish(State.COMPLETE)
    code, line = calibrate(of_balls, "--scan", place / "crossed.scan")
    assert code == 1, line  # among sound points still: not taken for an artefact
    ran = run("calibrate", of_balls / "station.toml", of_balls / "artefact.toml",
              "--scan", place / "crossed.scan", "--out", place / "no.toml")  # fmt: skip
    assert ran.exit_code == 1
    assert "x and z are exchanged" in ran.stderr
    assert not (place / "no.toml").exists()


def test_a_held_out_spacing_and_a_drift(of_balls: Path, place: Path) -> None:
    assert calibrate(of_balls) == (0, "")
    artefact = of_balls / "artefact.toml"
    sound = artefact.read_text()
    head, key, last = sound.rpartition("distance_mm = ")
    number, rest = last.split("\n", 1)
    artefact.write_text(f"{head}{key}{float(number) + 0.05:.6f}\n{rest}")
    try:
        for options, title in (
            ((), "The calibration is refused"),
            (("--check",), "The station has drifted"),
        ):
            code, line = calibrate(of_balls, *options)
            assert_told(line, code, title)
    finally:
        artefact.write_text(sound)


# -- plans and disks -------------------------------------------------------------------------------


def test_a_soft_limit_in_the_plan(station: Simulated, place: Path) -> None:
    write_rings(Path("high.toml"), 200)
    before = station.witness.read_bytes()
    end = scan(station, "high.toml")
    assert_told(end.line, end.code, "The plan leaves the soft limits")
    assert station.witness.read_bytes() == before
    assert not Path("part.scan").exists()


def test_a_folder_that_holds_a_scan(station: Simulated, place: Path, plan: str, sound: Path):
    shutil.copytree(sound, "part.scan")
    end = scan(station, plan)
    assert_told(end.line, end.code, "There is a scan already")


def test_a_limit_on_file_sizes_amid_a_scan(station: Simulated, place: Path) -> None:
    with scanning(station, "part.scan") as child:
        # Above what scan.json needs, below what a slice does.
        resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (8000, resource.RLIM_INFINITY))
        end = end_of(child)
    assert_told(end.line, end.code, "A limit on file sizes is reached")
    assert_nothing_lost(end)
    assert_dark(station)


@pytest.fixture
def small_disk(place: Path) -> Iterator[Path]:
    """A file system with room for a scan, and little more."""
    (place / "disk").mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", "disk"]
    if not shutil.which("mount") or subprocess.run(command, check=False).returncode:
        pytest.skip("a small file system cannot be mounted here")
    yield place / "disk"
    subprocess.run(["umount", str(place / "disk")], check=True)


def fill(file: Path) -> None:
    with file.open("wb", buffering=0) as filler, suppress(OSError):
        while True:
            filler.write(bytes(4096))


def test_a_disk_that_is_full_amid_a_scan(station: Simulated, small_disk: Path) -> None:
    with scanning(station, "disk/part.scan") as child:
        fill(small_disk / "other")
        end = end_of(child)
    assert_told(end.line, end.code, "The disk is full")
    assert_nothing_lost(end, "disk/part.scan")
    assert_dark(station)


def test_a_disk_that_is_too_small_for_the_scan(
    station: Simulated, place: Path, plan: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: shutil._ntuple_diskusage(10**6, 0, 10_000))
    end = scan(station, plan)
    assert_told(end.line, end.code, "The scan does not fit the disk")
    assert not Path("part.scan").exists()


def test_a_damaged_slice_is_set_aside_by_a_resume_which_takes_it_again(
    station: Simulated, place: Path, plan: str, sound: Path
) -> None:
    shutil.copytree(sound, "part.scan")
    damage(Path("part.scan"), 1)
    folder = ScanFolder.open(Path("part.scan"))
    (found,) = folder.verify().damaged
    assert found.file.name == "000001.npz"
    ran = run("scan", station, plan, "--out", "part.scan", "--resume")
    (note,) = [line for line in ran.stdout.splitlines() if "set aside" in line]
    assert_told(note, ran.exit_code, "A damaged slice is taken again")
    assert Path("part.scan/slices/000001.npz.damaged").is_file()
    for index in (0, 1):
        assert_same_measurement(folder.read(index), ScanFolder(sound).read(index))


def test_another_part_on_the_table_is_not_gone_on_with(place: Path, plan: str, sound: Path) -> None:
    shutil.copytree(sound, "part.scan")
    ScanFolder(Path("part.scan")).file(1).unlink()
    with simulate("cylinder", seed=SEED, scale=SCALE) as other:
        end = scan(other, plan, "--resume")
        assert end.code == 2
        assert "name was simulated station, vase, is simulated station, cylinder" in end.line
        renamed = changed(other, "station, cylinder", "station, vase")
        end = scan(renamed, plan, "--resume")
        assert_told(end.line, end.code, "It is another part")
        assert end.told == ()
        assert_dark(other)
    assert ScanFolder(Path("part.scan")).indices() == (0,)


def test_a_scan_json_that_is_damaged_is_mended(
    station: Simulated, place: Path, sound: Path
) -> None:
    shutil.copytree(sound, "part.scan")
    Path("part.scan/scan.json").write_text("{")
    ran = run("scans", "verify", "part.scan")
    line = ran.stderr.strip().removeprefix("loftscan: ")
    assert_told(line, ran.exit_code, "The record of a scan is damaged")
    succeeded(run("scans", "repair", "part.scan"))
    succeeded(run("scans", "verify", "part.scan"))


def test_damaged_slices_are_counted_by_verify(place: Path, sound: Path) -> None:
    shutil.copytree(sound, "part.scan")
    damage(Path("part.scan"), 1)
    ran = run("scans", "verify", "part.scan")
    line = ran.stderr.strip().removeprefix("loftscan: ")
    assert_told(line, ran.exit_code, "Slices are damaged")


def test_a_damaged_slice_is_left_out_by_a_reconstruction(
    place: Path, without_pictures: None
) -> None:
    write_scan(place / "vase.scan")
    damage(place / "vase.scan", 6)
    ran = run("reconstruct", "vase.scan", "--out", "o", "--formats", "stl")
    warning, ends = ran.stderr.splitlines()
    assert ends == f"warning: {ENDS}"
    assert_told(warning, ran.exit_code, "A damaged slice is left out")


def test_points_that_the_network_lost_are_said_by_a_reconstruction(
    place: Path, without_pictures: None
) -> None:
    def lossy(profile: Profile) -> Profile:
        return replace(profile, reasons=np.r_[[Reason.LOST] * 5, profile.reasons[5:]])

    kept = [replace(each, profiles=tuple(map(lossy, each.profiles))) for each in sweeps()]
    write_scan(place / "vase.scan", kept)
    ran = run("reconstruct", "vase.scan", "--out", "o", "--formats", "stl")
    warning, ends = ran.stderr.splitlines()
    assert ends == f"warning: {ENDS}"
    assert_told(warning, ran.exit_code, "The network loses points")
    assert "(3.1%)" in warning  # 5 of 160


# -- the operator ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("signals", "title"),
    [([signal.SIGINT], "You paused the scan"), ([signal.SIGTERM], "You stopped the scan")],
)
def test_an_operator_who_has_enough(
    station: Simulated, place: Path, signals: list[signal.Signals], title: str
) -> None:
    with scanning(station, "part.scan") as child:
        for number in signals:
            child.send_signal(number)
        end = end_of(child)
    assert_told(end.line, end.code, title)
    assert_dark(station)
    assert set(end.told) <= set(ScanFolder.open(Path("part.scan")).verify().sound)
