"""What goes wrong with people and machines: one line, the remedy, a code, nothing left behind."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from tests.conftest import Saved
from tests.system.command_cases import (
    FloatArray,
    complaint,
    contents,
    run,
    start,
    succeeded,
    write_cloud,
)


def refused(place: Path, code: int, *arguments: object) -> str:
    """The one line of a run that fails; every file, hidden and temporary too, is as before."""
    before = contents(place)
    line = complaint(run(*arguments), code)
    assert contents(place) == before
    return line


@pytest.fixture
def cloud(place: Path, part_points: FloatArray) -> str:
    return write_cloud(place / "part.npy", part_points).name


# -- files that are no cloud ---------------------------------------------------------------------


def ply(points: FloatArray, encoding: str, body: bytes) -> bytes:
    fields = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat {encoding} 1.0\nelement vertex {len(points)}\n{fields}end_header\n"
    return head.encode() + body


def pcd(points: FloatArray, body: bytes) -> bytes:
    count = len(points)
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    ).encode() + body


def text(points: FloatArray) -> bytes:
    return b"".join(b"%.6f %.6f %.6f\n" % tuple(point) for point in points)


TRUNCATED = {
    "binary.ply": lambda p: ply(p, "binary_little_endian", p.astype("<f4").tobytes()[:-30]),
    "ascii.ply": lambda p: ply(p, "ascii", text(p)[: len(text(p)) // 2]),
    "binary.pcd": lambda p: pcd(p, p.astype("<f4").tobytes()[:-30]),
    "counted.pts": lambda p: b"%d\n" % len(p) + text(p)[: len(text(p)) // 2],
    "header.ply": lambda p: ply(p, "ascii", b"")[:40],
}


@pytest.mark.parametrize("name", TRUNCATED)
def test_a_truncated_file_is_refused_by_its_name(
    place: Path, part_points: FloatArray, name: str
) -> None:
    (place / name).write_bytes(TRUNCATED[name](part_points))
    line = refused(place, 2, "reconstruct", name, "--out", "o")
    assert line.startswith(f"{name}: ")
    assert "copy or export it again" in line
    if name != "header.ply":
        assert "truncated" in line
        assert f"{len(part_points):,}".replace(",", " ") in line  # what was promised


def test_a_truncated_npy_is_refused(place: Path, cloud: str) -> None:
    data = (place / cloud).read_bytes()
    (place / cloud).write_bytes(data[:-100])
    assert "truncated" in refused(place, 2, "reconstruct", cloud, "--out", "o")


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".xyz", ".pts", ".txt", ".csv", ".npy"])
def test_an_empty_file_and_rubbish_are_refused_in_every_format(place: Path, suffix: str) -> None:
    (place / f"empty{suffix}").touch()
    line = refused(place, 2, "reconstruct", f"empty{suffix}", "--out", "o")
    assert line == f"empty{suffix}: the file is empty; copy or export it again"
    (place / f"rubbish{suffix}").write_bytes(np.random.default_rng(5).bytes(3000))
    line = refused(place, 2, "reconstruct", f"rubbish{suffix}", "--out", "o")
    assert line.startswith(f"rubbish{suffix}: ")
    assert line.isprintable()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("words.xyz", "1 2 3\n4 5 six\n", "line 2: 'six' is not a number; correct or remove it"),
        ("words.csv", "x,y,z\n1,2,3\n4,,six\n", "line 3: 'six' is not a number"),
        ("narrow.xyz", "1 2\n3 4\n", "line 1: 2 columns, x, y and z are needed"),
        ("nameless.csv", "a,b,c\n1,2,3\n", "its header names no x, y and z"),
        ("nan.xyz", "nan nan nan\n" * 50, "none of its 50 points is finite"),
        (
            "three.xyz",
            "1 2 3\n4 5 6\n7 8 10\n",
            "3 points in the cloud: a surface needs at least 4",
        ),
        ("one.csv", "x,y,z\n1,2,3\n", "1 points in the cloud: a surface needs at least 4"),
        ("same.xyz", "1 2 3\n" * 1000, "all 1000 points lie in one place: is this the right file?"),
        ("part.stp", "1 2 3\n", "unknown extension '.stp'; convert it to one of .ply .pcd .xyz"),
        ("part", "1 2 3\n", "unknown extension ''"),
    ],
)
def test_a_file_that_is_no_cloud_is_refused(
    place: Path, name: str, content: str, said: str
) -> None:
    (place / name).write_text(content)
    line = refused(place, 2, "reconstruct", name, "--out", "o")
    assert line.startswith(f"{name}: {said}")


def test_a_missing_file_and_a_folder_are_refused(place: Path) -> None:
    (place / "folder").mkdir()
    line = refused(place, 2, "reconstruct", "missing.ply", "--out", "o")
    assert line == "missing.ply: there is no such file; check the path"
    line = refused(place, 2, "reconstruct", "folder", "--out", "o")
    assert line == "folder: is a folder; name the cloud file in it"
    line = refused(place, 2, "compare", "folder", "missing.ply", "--out", "o")
    assert line.startswith("folder: no mesh.ply in it")


# -- a part of the wrong size --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scale", "said", "unit"),
    [
        (10_000 / 44.0, "10 m wide in --unit mm", "um"),
        (0.01 / 44.0, "10 µm wide in --unit mm", "m"),
    ],
)
def test_an_implausible_size_is_a_warning_that_names_the_unit(
    place: Path, part_points: FloatArray, without_pictures: None, scale, said, unit
) -> None:
    # 44 mm is how wide the part is.
    write_cloud(place / "part.npy", part_points * scale)
    ran = succeeded(run("reconstruct", "part.npy", "--out", "o", "--formats", "ply"))
    assert ran.stderr.startswith("warning: the part is ")
    assert said in ran.stderr
    assert f"With --unit {unit} it would be 10" in ran.stderr
    assert sum("wide in --unit" in line for line in ran.stderr.splitlines()) == 1
    assert all(line.startswith("warning: ") for line in ran.stderr.splitlines())
    assert "watertight" in ran.stdout
    ran = succeeded(
        run("reconstruct", "part.npy", "--out", "p", "--formats", "ply", "--method", "paper")
    )
    assert len(ran.stderr.splitlines()) == 1


def test_a_plausible_size_is_no_warning(place: Path, cloud: str, without_pictures: None) -> None:
    options = ("reconstruct", cloud, "--formats", "ply")
    assert "wide in --unit" not in succeeded(run(*options, "--out", "o")).stderr
    assert succeeded(run(*options, "--out", "p", "--method", "paper")).stderr == ""


# -- wrong options -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--axis", "w"], "--axis 'w': one of x, y, z expected"),
        (["--method", "spline"], "--method 'spline': one of fit, paper expected"),
        (
            ["--method", "paper", "--nurbs", "always"],
            "--nurbs: means nothing to --method paper; leave it out, or choose --method fit",
        ),
        (["--nurbs", "no"], "--nurbs 'no': one of auto, always expected"),
        (
            ["--method", "paper", "--exact", "never"],
            "--exact: means nothing to --method paper; leave it out, or choose --method fit",
        ),
        (
            ["--resolution-mm", "1"],
            "--resolution-mm: means nothing to --method fit; leave it out, or choose"
            " --method paper",
        ),
        (
            ["--intermediate", "2"],
            "--intermediate: means nothing to --method fit; leave it out, or choose --method paper",
        ),
        (["--unit", "km"], "--unit 'km': one of mm, cm, m, um, inch expected"),
        (
            ["--formats", "stl,obj"],
            "--formats 'obj': one of step, 3dm, stl, ply, glb, iges expected",
        ),
        (["--crop", "1,2,3"], "--crop '1,2,3': six numbers xmin,xmax,ymin,ymax,zmin,zmax"),
        (["--crop", "a,1,,,,"], "--crop 'a,1,,,,': "),
        (["--crop", "2,1,,,,"], "--crop '2,1,,,,': every minimum must be below its maximum"),
        (["--crop", "500,600,,,,"], "part.npy inside --crop: 0 points in the cloud"),
        (["--spacing-mm", "-1"], "--spacing-mm -1: a length above 0 mm is expected"),
        (["--spacing-mm", "0"], "--spacing-mm 0: a length above 0 mm is expected"),
        (["--spacing-mm", "nan"], "--spacing-mm nan: a length above 0 mm is expected"),
        (["--resolution-mm", "-0.5"], "--resolution-mm -0.5: a length above 0 mm is expected"),
        (["--tolerance-mm", "inf"], "--tolerance-mm inf: a length above 0 mm is expected"),
        (["--remesh-mm", "-1"], "--remesh-mm -1: a length above 0 mm is expected"),
        (["--decimate-faces", "3"], "--decimate-faces 3: a closed mesh has at least 4"),
        (["--intermediate", "-1"], "--intermediate -1: 0 to 1000 rows"),
    ],
)
def test_a_wrong_option_is_bad_usage(
    place: Path, cloud: str, options: list[str], said: str
) -> None:
    assert refused(place, 2, "reconstruct", cloud, "--out", "o", *options).startswith(said)


def test_a_spacing_larger_than_the_part_makes_no_surface(place: Path, cloud: str) -> None:
    line = refused(place, 1, "reconstruct", cloud, "--out", "o", "--spacing-mm", "500")
    assert line == (
        "1 of 1 slices gave a closed section, two are needed: choose a smaller --spacing-mm"
    )


def test_an_absurdly_small_spacing_is_refused_before_it_fills_the_memory(
    place: Path, cloud: str
) -> None:
    line = refused(place, 2, "reconstruct", cloud, "--out", "o", "--spacing-mm", "1e-7")
    assert "a spacing of 1e-07 mm makes 3" in line
    assert line.endswith("at most 100000 are possible: choose a larger --spacing-mm")


def test_what_the_parser_refuses_is_bad_usage_too(place: Path) -> None:
    for arguments in (
        ["reconstruct"],
        ["reconstruct", "part.npy"],
        ["reconstruct", "part.npy", "--out", "o", "--spacing-mm", "wide"],
        ["reconstruct", "part.npy", "--out", "o", "--no-such"],
        ["compare", "part.npy", "--out", "o"],
        ["demo", "--seed", "-1"],
        ["no-such-command"],
    ):
        ran = run(*arguments)
        assert ran.exit_code == 2, arguments
        assert "Error: " in ran.stderr
        assert isinstance(ran.exception, SystemExit)
    assert contents(place) == {"temporary": None}


def test_a_traceback_is_shown_to_whom_asks_for_it(place: Path) -> None:
    from reconstruction.errors import UnreadableCloud

    ran = run("reconstruct", "missing.ply", "--out", "o", "--debug")
    assert isinstance(ran.exception, UnreadableCloud)


# -- the output folder ---------------------------------------------------------------------------


def test_a_folder_that_holds_something_is_refused_before_the_work(
    place: Path, cloud: str, saved: Saved
) -> None:
    (place / "mine").mkdir()
    (place / "mine/notes.txt").write_text("years of work")
    shutil.copytree(saved.folder, place / "old")
    # The cloud is missing: what comes first is said first.
    line = refused(place, 2, "reconstruct", "missing.ply", "--out", "mine")
    assert line == "mine: is there already; name another --out, or add --overwrite"
    line = refused(place, 2, "reconstruct", cloud, "--out", "mine", "--overwrite")
    assert line == "mine: holds no result of loftscan, so it is not overwritten"
    assert "is there already" in refused(place, 2, "reconstruct", cloud, "--out", "old")
    assert "is there already" in refused(place, 2, "demo", "--out", "old")
    assert "is there already" in refused(place, 2, "compare", cloud, cloud, "--out", "old")
    line = refused(place, 2, "compare", cloud, cloud, "--out", "old", "--overwrite")
    assert "holds no result" in line


def test_overwriting_never_deletes_what_is_no_part_of_a_result(place: Path, saved: Saved) -> None:
    shutil.copytree(saved.folder, place / "old")
    shutil.copy(saved.cloud, place / "old/part.xyz")
    line = refused(place, 2, "reconstruct", "old/part.xyz", "--out", "old", "--overwrite")
    assert line.startswith("old: holds part.xyz beside the result, so it is not overwritten")


def test_an_older_result_is_replaced_whole_when_asked(
    place: Path, cloud: str, saved: Saved, without_pictures: None
) -> None:
    shutil.copytree(saved.folder, place / "old")
    options = ("--out", "old", "--overwrite", "--formats", "glb", "--crop", ",,,,,15")
    succeeded(run("reconstruct", cloud, *options))
    assert not (place / "old/mesh.stl").exists()
    new, former = (folder / "metrics.json" for folder in (place / "old", saved.folder))
    assert new.read_bytes() != former.read_bytes()


def test_an_empty_folder_and_new_parents_are_fine(
    place: Path, cloud: str, without_pictures: None
) -> None:
    (place / "empty").mkdir()
    (place / "link").symlink_to("empty")
    for out in ("empty", "new/and/deep"):
        succeeded(run("reconstruct", cloud, "--out", out, "--formats", "ply"))
        assert (place / out / "metrics.json").is_file()
    shutil.rmtree(place / "empty")
    (place / "empty").mkdir()
    succeeded(run("reconstruct", cloud, "--out", "link", "--formats", "ply"))
    assert (place / "empty/metrics.json").is_file()
    assert (place / "link").is_symlink()


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("part.npy", "part.npy: is a file, not a folder; name another --out"),
        ("part.npy/o", "part.npy/o: part.npy is a file, not a folder; name another --out"),
        (".", ".: the result needs a folder of its own; name a new --out"),
        ("", ".: the result needs a folder of its own; name a new --out"),
        ("..", "..: the result needs a folder of its own; name a new --out"),
    ],
)
def test_a_place_where_no_folder_can_be_is_refused(
    place: Path, cloud: str, out: str, said: str
) -> None:
    assert refused(place, 2, "reconstruct", cloud, "--out", out) == said


def test_a_place_that_may_not_be_written_is_refused_before_the_work(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if os.getuid() == 0:  # who may write everywhere
        monkeypatch.setattr(os, "access", lambda path, mode: False)
    (place / "locked").mkdir(mode=0o555)
    for arguments in (["reconstruct", "missing.ply"], ["compare", "a", "b"], ["demo"]):
        line = refused(place, 1, *arguments, "--out", "locked/o")
        assert line == (
            "locked/o: no permission to write there; name a folder that may be written as --out"
        )


# -- the machine ---------------------------------------------------------------------------------


@pytest.mark.parametrize("sync", [1, 2, 5])
def test_a_full_disk_is_said_and_leaves_nothing(
    place: Path, cloud: str, saved: Saved, without_pictures: None, monkeypatch, sync: int
) -> None:
    left = iter(range(sync - 1))
    written = os.fsync

    def fsync(descriptor: int) -> None:
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    line = refused(place, 1, "reconstruct", cloud, "--out", "a/b/o", "--formats", "stl,ply")
    assert line == (
        "a/b/o: the disk is full; free some space and run again, nothing half-written is left"
    )
    # An older result is whole afterwards.
    shutil.copytree(saved.folder, place / "old")
    left = iter(range(sync - 1))
    refused(place, 1, "reconstruct", cloud, "--out", "old", "--overwrite", "--formats", "stl,ply")


@pytest.fixture
def tiny_disk(place: Path):
    """A file system with room for 300 kB."""
    disk = place / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(disk)]
    try:
        mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if not mounted:
        pytest.skip("a small file system cannot be mounted here")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("formats", ["step,3dm", "stl,ply,glb"])
def test_a_disk_that_is_really_full_is_said_and_leaves_nothing(
    place: Path, cloud: str, tiny_disk: Path, without_pictures: None, formats: str
) -> None:
    (tiny_disk / "other").write_bytes(bytes(120_000))
    line = refused(place, 1, "reconstruct", cloud, "--out", "disk/o", "--formats", formats)
    assert line.startswith("disk/o: the disk is full; free some space and run again")


def test_a_missing_system_library_of_pymeshlab_is_named_with_its_remedy(
    place: Path, cloud: str, without_pictures: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    (place / "fake").mkdir()
    lost = "libGL.so.1: cannot open shared object file: No such file or directory"
    (place / "fake/pymeshlab.py").write_text(f"raise ImportError({lost!r})\n")
    monkeypatch.setenv("PYTHONPATH", str(place / "fake"))
    line = refused(place, 1, "reconstruct", cloud, "--out", "o", "--remesh-mm", "2")
    assert line == f"pymeshlab: {lost}; run: apt-get install libgl1 libopengl0"
    # A mesh that needs no repair needs no pymeshlab either.
    succeeded(run("reconstruct", cloud, "--out", "o", "--formats", "ply"))


@pytest.mark.parametrize(("form", "library"), [("step", "OCP"), ("3dm", "rhino3dm")])
def test_a_missing_extra_is_an_error_when_asked_for_and_else_a_warning(
    place: Path, cloud: str, without_pictures: None, monkeypatch, form: str, library: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)  # Python's own way to say: not there
    line = refused(place, 1, "reconstruct", cloud, "--out", "o", "--formats", f"ply,{form}")
    assert line == (
        f"writing {form} needs the library {library}: pip install 'loftscan[cad]', "
        "or choose other --formats"
    )
    ran = succeeded(run("reconstruct", cloud, "--out", "o"))
    assert f"warning: {form} left out" in ran.stderr
    assert "pip install 'loftscan[cad]'" in ran.stderr
    assert not (place / f"o/surface.{form}").exists()
    assert (place / "o/mesh.glb").exists()


@pytest.mark.parametrize(
    "stage",
    ["loftscan.reconstructing.cut_cloud", "loftscan.reconstructing.compare_to_mesh",
     "loftscan.result.write_surface_json", "loftscan.result.write_stl"],
)  # fmt: skip
def test_who_stops_the_work_gets_code_3_and_nothing_is_left(
    place: Path, cloud: str, without_pictures: None, monkeypatch, stage: str
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, stop)
    line = refused(place, 3, "reconstruct", cloud, "--out", "a/o")
    assert line == "stopped by the operator; nothing was written"


def test_a_real_interrupt_ends_the_real_program_with_code_3(place: Path) -> None:
    child = start("demo", "--out", "o", "--json", "--scale", "40", cwd=place)
    assert child.stdout is not None
    while '"event": "section"' not in child.stdout.readline():
        assert child.poll() is None
    child.send_signal(signal.SIGINT)
    _, stderr = child.communicate(timeout=60)
    assert child.returncode == 3
    assert stderr == "loftscan: stopped by the operator; the slices so far are kept in o.scan\n"
    assert not (place / "o").exists()
    kept = ScanFolder.open(place / "o.scan")
    assert kept.record().state is State.ABORTED
    assert kept.verify().sound
    assert kept.verify().damaged == ()


def test_want_of_memory_is_said_with_the_remedy(
    place: Path, cloud: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 1.10 EiB")

    monkeypatch.setattr("loftscan.reconstructing.cut_cloud", fail)
    line = refused(place, 1, "reconstruct", cloud, "--out", "o")
    assert line.startswith("out of memory (Unable to allocate 1.10 EiB); use a larger --resolution")


def test_the_console_script_speaks_the_same_as_the_application(place: Path) -> None:
    child = start("reconstruct", "missing.ply", "--out", "o", cwd=place)
    stdout, stderr = child.communicate(timeout=60)
    assert (child.returncode, stdout) == (2, "")
    assert stderr == "loftscan: missing.ply: there is no such file; check the path\n"
