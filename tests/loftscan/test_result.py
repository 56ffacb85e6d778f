"""A result folder: whole or not at all, and never at the cost of somebody else's file."""

from __future__ import annotations

import errno
import json
import os
import sys
from pathlib import Path

import pytest

from loftscan import result as results
from loftscan.result import USUAL_FORMATS, OutputExists, Result, appearing_whole, choose_formats
from reconstruction.errors import MissingExtra
from tests.system.command_cases import contents


@pytest.mark.parametrize("method", ["fit", "paper"])
def test_a_result_has_what_its_parts_have(
    part_result: Result, paper_result: Result, method: str
) -> None:
    result = {"fit": part_result, "paper": paper_result}[method]
    done = result.reconstruction
    # A fit makes its patches when asked for them; the net in them is the one that was fitted.
    for one, other in zip(result.surface, done.patches, strict=True):
        assert one.control_points_mm.tobytes() == other.control_points_mm.tobytes()
        assert (one.knots_u.tobytes(), one.knots_v.tobytes()) == (
            other.knots_u.tobytes(), other.knots_v.tobytes()
        )  # fmt: skip
    if method == "paper":
        assert result.surface is done.patches
    assert result.sections is done.sections
    assert result.mesh is done.mesh
    assert result.name == "array"


def test_saving_returns_the_folder_and_twice_gives_the_same_bytes(
    place: Path, part_result: Result, without_pictures: None
) -> None:
    formats = ("stl", "ply", "glb")
    assert part_result.save("a", formats=formats) == Path("a")
    assert part_result.save(place / "b", formats=formats) == place / "b"
    assert contents(place / "a") == contents(place / "b")
    assert set(contents(place)) >= {"a", "b", "temporary"}
    assert not any(name.startswith(".") for name in contents(place))


def test_the_sections_of_the_folder_are_those_of_the_result(
    place: Path, part_result: Result, without_pictures: None
) -> None:
    part_result.save("o", formats=["ply"])
    told = json.loads((place / "o/sections.json").read_text())["sections"]
    # An entry a curve: this part has one a slice.
    for entry, section in zip(told, part_result.sections, strict=True):
        (drawn,) = section.curves
        assert entry["index"] == section.index
        assert entry["height_mm"] == section.height_mm
        assert entry["residual"]["rms_mm"] == drawn.residual_rms_mm
        assert entry["residual"]["points"] == drawn.points
        assert [tuple(gap) for gap in entry["gaps"]] == [tuple(gap) for gap in drawn.gaps]


def test_the_sections_of_the_folder_are_those_of_the_paper(
    place: Path, paper_result: Result, without_pictures: None
) -> None:
    paper_result.save("o", formats=["ply"])
    told = json.loads((place / "o/sections.json").read_text())["sections"]
    for entry, section in zip(told, paper_result.sections, strict=True):
        assert entry["index"] == section.index
        assert entry["height_mm"] == section.height_mm
        assert entry["residual"]["rms_mm"] == section.residual.rms_mm
        assert entry["residual"]["points"] == section.residual.count
        assert [tuple(gap) for gap in entry["gaps"]] == list(section.gaps)


# -- formats -------------------------------------------------------------------------------------


def test_formats_are_chosen_once_each_in_the_order_asked() -> None:
    assert choose_formats(None) == USUAL_FORMATS
    assert choose_formats(["iges"]) == ("iges",)
    assert choose_formats(["ply", " STL ", "ply", ""]) == ("ply", "stl")
    with pytest.raises(ValueError, match=r"^--formats 'obj': one of step, 3dm, stl, ply, glb"):
        choose_formats(["stl", "obj"])
    with pytest.raises(ValueError, match=r"^--formats '': one of step, 3dm, stl, ply, glb"):
        choose_formats([" "])


@pytest.mark.parametrize(("form", "library"), [("step", "OCP"), ("3dm", "rhino3dm")])
def test_a_format_without_its_library_is_left_out_or_refused(
    monkeypatch: pytest.MonkeyPatch, form: str, library: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    assert choose_formats(None) == tuple(each for each in USUAL_FORMATS if each != form)
    with pytest.raises(MissingExtra, match=rf"{library}: pip install 'loftscan\[cad\]'"):
        choose_formats([form])


# -- whole or not at all -------------------------------------------------------------------------


def test_a_folder_appears_only_when_the_block_ends(place: Path) -> None:
    target = place / "new/o"
    with appearing_whole(target, overwrite=False) as partial:
        (partial / "metrics.json").write_text("{}")
        assert not target.exists()
    assert contents(place) == {
        "temporary": None, "new": None, "new/o": None, "new/o/metrics.json": b"{}"
    }  # fmt: skip


def interrupted(target: Path, end: BaseException) -> None:
    with appearing_whole(target, overwrite=True) as partial:
        (partial / "metrics.json").write_text("new")
        raise end


@pytest.mark.parametrize("end", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt(), ValueError()])
def test_whatever_ends_the_block_leaves_what_was_there_before(
    place: Path, end: BaseException
) -> None:
    (place / "old").mkdir()
    for mark in results.MARKS:
        (place / "old" / mark).write_text("old")
    (place / "empty").mkdir()
    before = contents(place)
    for name in ("old", "empty", "new/and/deep"):
        with pytest.raises(type(end)):
            interrupted(place / name, end)
        assert contents(place) == before


def test_an_error_names_the_folder_that_the_person_named(place: Path) -> None:
    with (
        pytest.raises(OSError, match="full") as failure,
        appearing_whole(Path("o"), overwrite=False) as partial,
    ):
        raise OSError(errno.ENOSPC, "full", str(partial / "mesh.stl"))
    assert failure.value.filename == "o"
    with (
        pytest.raises(FileNotFoundError) as failure,
        appearing_whole(Path("o"), overwrite=False),
    ):
        (place / "elsewhere").read_bytes()
    assert failure.value.filename == str(place / "elsewhere")


def test_the_rest_of_a_killed_run_is_no_obstacle(place: Path) -> None:
    (place / ".o.partial").mkdir()
    (place / ".o.partial/mesh.stl").write_text("half")
    with appearing_whole(place / "o", overwrite=False) as partial:
        (partial / "metrics.json").write_text("{}")
    assert set(contents(place)) == {"temporary", "o", "o/metrics.json"}


@pytest.mark.parametrize("name", ["notes.txt", "cloud.ply", ".hidden", "metrics.json.orig"])
def test_a_foreign_file_keeps_a_folder_from_being_replaced(place: Path, name: str) -> None:
    (place / "o").mkdir()
    for mark in (*results.MARKS, name):
        (place / "o" / mark).write_text("x")
    with pytest.raises(OutputExists, match=f"^o: holds {name} beside the result"):
        results.check_output(Path("o"), overwrite=True)
    (place / "o" / name).unlink()
    results.check_output(Path("o"), overwrite=True)
    with pytest.raises(OutputExists, match=r"^o: is there already"):
        results.check_output(Path("o"), overwrite=False)


@pytest.mark.skipif(os.getuid() == 0, reason="root may write everywhere")
def test_a_locked_folder_is_refused_before_the_work(place: Path) -> None:
    (place / "locked").mkdir(mode=0o500)
    with pytest.raises(PermissionError):
        results.check_output(place / "locked/o", overwrite=False)
