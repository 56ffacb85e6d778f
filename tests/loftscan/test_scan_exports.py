"""Each export read back by a library that did not write it, and held against the scan itself.

.nxs by pyfive (pure Python), .ply by plyfile and trimesh, .e57 by the crate e57 and by pye57, .xyz
by numpy, .las by its specification. The truth is numpy on the slice files, written out here.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.frames import Kinematics, Lifting, Side, Turning
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from loftscan.scan_exports import export_scan
from tests.loftscan.made_scans import KINEMATICS, damage, record, sweeps, write_scan

TURNED = replace(
    KINEMATICS,
    table_sense=Turning.CLOCKWISE,
    stage_sense=Lifting.DOWN,
    sensor_x=Side.LEFT,
    side_mm=1.25,
    azimuth_deg=33.0,
)


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scan(tmp_path_factory.mktemp("kept") / "vase.scan")


def truth(path: Path) -> dict[str, np.ndarray]:
    """Points of the nominal station from the columns of the slice files, by docs/frames.md."""
    found = []
    for file in sorted(path.glob("slices/*.npz")):
        with np.load(file) as columns:
            profile = np.repeat(np.arange(len(columns["lengths"])), columns["lengths"])
            x = columns["x"] * columns["scale_mm"][profile, 0] + columns["offset_mm"][profile, 0]
            z = columns["z"] * columns["scale_mm"][profile, 1] + columns["offset_mm"][profile, 1]
            turn = -columns["table_rad"][profile]
            along, height = 225.0 - z, 1.5 + columns["stage_mm"][profile]
            point = [
                along * np.cos(turn) - x * np.sin(turn),
                along * np.sin(turn) + x * np.cos(turn),
                height,
            ]
            rows = np.column_stack([*point, columns["intensity"], np.full(len(x), int(file.stem))])
            found.append(rows[columns["reasons"] == 0])
    rows = np.concatenate(found)
    return {"points": rows[:, :3], "intensity": rows[:, 3], "slice": rows[:, 4]}


def assert_header(text: str, unit: str = "mm") -> None:
    """Unit, frame and provenance are said."""
    for said in ("part: origin on the table's axis", "calibration_sha256", "software", unit):
        assert said in text, text[:400]


def test_a_ply_is_read_by_others_and_says_where_it_came_from(scan: Path, tmp_path: Path) -> None:
    from plyfile import PlyData

    done = export_scan(scan, tmp_path / "vase.ply")
    due = truth(scan)
    read = PlyData.read(str(tmp_path / "vase.ply"))
    vertex = read["vertex"]
    assert done.points == len(vertex) == len(due["points"])
    np.testing.assert_allclose(
        np.column_stack([vertex[axis] for axis in "xyz"]), due["points"], atol=1e-9
    )
    np.testing.assert_array_equal(vertex["intensity"], due["intensity"])
    np.testing.assert_array_equal(vertex["slice"], due["slice"])
    assert_header("\n".join(read.comments), "unit: mm")


def test_a_ply_opens_as_a_cloud_here_and_in_trimesh(scan: Path, tmp_path: Path) -> None:
    import trimesh

    from reconstruction.clouds import open_cloud

    export_scan(scan, tmp_path / "vase.ply")
    due = truth(scan)["points"]
    loaded = trimesh.load(tmp_path / "vase.ply")
    np.testing.assert_allclose(np.asarray(loaded.vertices), due, atol=1e-4)
    ours = np.concatenate([each.points for each in open_cloud(tmp_path / "vase.ply").chunks()])
    np.testing.assert_allclose(ours, due, atol=1e-9)


def test_an_xyz_is_rows_of_numbers_after_comments(scan: Path, tmp_path: Path) -> None:
    from reconstruction.clouds import open_cloud

    out = tmp_path / "vase.xyz"
    export_scan(scan, out)
    due = truth(scan)
    rows = np.loadtxt(out)
    np.testing.assert_allclose(rows[:, :3], due["points"], atol=0.51e-6)
    np.testing.assert_array_equal(rows[:, 3:5], np.column_stack([due["intensity"], due["slice"]]))
    head = "\n".join(each for each in out.read_text().splitlines() if each.startswith("#"))
    assert_header(head, "unit: mm")
    ours = np.concatenate([each.points for each in open_cloud(out).chunks()])
    np.testing.assert_allclose(ours, due["points"], atol=0.51e-6)


def test_an_e57_is_in_metres_and_read_without_the_library_that_wrote_it(
    scan: Path, tmp_path: Path
) -> None:
    e57, pye57 = pytest.importorskip("e57"), pytest.importorskip("pye57")
    out = tmp_path / "vase.e57"
    assert export_scan(scan, out).unit == "m"
    due = truth(scan)
    other = e57.read_points(str(out))
    np.testing.assert_allclose(1000.0 * np.asarray(other.points), due["points"], atol=1e-9)
    assert_header(e57.raw_xml(str(out)).replace("&quot;", '"'), '"unit": "m"')
    with pye57.E57(str(out)) as read:
        header = read.get_header(0)
        assert header.point_count == len(due["points"])
        columns = read.read_scan_raw(0)
        bounds = header["cartesianBounds"]
        assert bounds["xMinimum"].value() == pytest.approx(due["points"][:, 0].min() / 1000.0)
        assert bounds["zMaximum"].value() == pytest.approx(due["points"][:, 2].max() / 1000.0)
        assert json.loads(header["description"].value())["scanned_unit"] == "mm"
    np.testing.assert_array_equal(columns["rowIndex"], due["slice"])
    np.testing.assert_array_equal(columns["intensity"], due["intensity"])


def test_a_las_is_what_its_specification_says(scan: Path, tmp_path: Path) -> None:
    """Read by LAS 1.4 R15, table 3 (header), 4 (records) and 17 (point format 6)."""
    laspy = pytest.importorskip("laspy")
    out = tmp_path / "vase.las"
    export_scan(scan, out)
    due = truth(scan)
    data = out.read_bytes()
    assert data[:4] == b"LASF"
    assert (data[24], data[25], data[104]) == (1, 4, 6)
    assert struct.unpack_from("<H", data, 6)[0] & 0x10, "the coordinate system is WKT"
    head_bytes, start, records = struct.unpack_from("<HLL", data, 94)
    (row_bytes,) = struct.unpack_from("<H", data, 105)
    scale, offset = struct.unpack_from("<3d", data, 131), struct.unpack_from("<3d", data, 155)
    (count,) = struct.unpack_from("<Q", data, 247)
    texts, place = {}, head_bytes
    for _ in range(records):
        user, number, length = struct.unpack_from("<2x16sHH", data, place)
        texts[user.rstrip(b"\0"), number] = data[place + 54 : place + 54 + length]
        place += 54 + length
    assert b'UNIT["millimetre",0.001]' in texts[b"LASF_Projection", 2112]
    assert_header(texts[b"LASF_Spec", 3].decode(), '"unit": "mm"')
    assert count == len(due["points"])
    rows = np.frombuffer(data, np.uint8, count * row_bytes, start).reshape(count, row_bytes)
    integers = rows[:, :12].copy().view("<i4")
    np.testing.assert_allclose(integers * scale + offset, due["points"], atol=0.51e-4)
    np.testing.assert_array_equal(rows[:, 12:14].copy().view("<u2")[:, 0], due["intensity"])
    np.testing.assert_array_equal(rows[:, 30:34].copy().view("<i4")[:, 0], due["slice"])
    with laspy.open(out) as read:
        assert read.header.point_count == count
        np.testing.assert_array_equal(read.read()["slice"], due["slice"])


@pytest.mark.parametrize("kinematics", [KINEMATICS, TURNED], ids=["as drawn", "turned"])
def test_a_nexus_file_says_where_every_point_stands_by_its_transformations(
    tmp_path: Path, kinematics: Kinematics
) -> None:
    """Read by pyfive; the chain of depends_on is walked as the NeXus manual tells."""
    pytest.importorskip("h5py")
    pyfive = pytest.importorskip("pyfive")
    writer = ScanFolder.create(tmp_path / "vase.scan", record(kinematics))
    for each in sweeps()[:3]:
        writer.append(each)
    writer.mark(State.ABORTED)
    writer.close()
    export_scan(tmp_path / "vase.scan", tmp_path / "vase.nxs")
    with pyfive.File(tmp_path / "vase.nxs") as root:
        entry = root["entry"]
        detector, sample, data = entry["instrument/profiler"], entry["sample"], entry["points"]
        profile = data["profile"][...]
        flat = data["in_plane"][...]
        local = np.column_stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]])
        sensor, table = walked(detector, "stage"), walked(sample, "table")
        for k in np.unique(profile):
            own = profile == k
            there = np.column_stack([local[own], np.ones(own.sum())]) @ sensor(k).T
            part = there @ np.linalg.inv(table(k)).T
            np.testing.assert_allclose(part[:, :3], data["points"][...][own], atol=1e-9)
        assert data["points"].attrs["units"] in (b"mm", "mm")
        about = entry["provenance/data"][()]
        assert_header(about.decode() if isinstance(about, bytes) else about, '"unit": "mm"')
        counts = detector["counts"][...]
        due = [p for sweep in sweeps()[:3] for p in sweep.profiles]
        np.testing.assert_array_equal(counts, np.concatenate([p.counts for p in due]))
        np.testing.assert_array_equal(
            detector["reasons"][...], np.concatenate([p.reasons for p in due])
        )
        assert entry["provenance"].attrs["NX_class"] in (b"NXnote", "NXnote")


def walked(component: object, moving: str):
    """The component's pose (4, 4) at profile k, by following depends_on to the end."""

    def text(value: object) -> str:
        return value.decode() if isinstance(value, bytes) else str(value)

    def pose(k: int) -> np.ndarray:
        whole = np.eye(4)
        name = text(component["depends_on"][()])
        steps = component["transformations"]
        while name != ".":
            name = name.removeprefix("transformations/")
            field = steps[name]
            value = field[...][k] if name == moving else float(field[()])
            vector = np.asarray(field.attrs["vector"], float)
            step = np.eye(4)
            if text(field.attrs["transformation_type"]) == "translation":
                step[:3, 3] = value * vector
            else:
                x, y, z = vector
                cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
                step[:3, :3] += math.sin(value) * cross + (1 - math.cos(value)) * cross @ cross
            whole = step @ whole
            name = text(field.attrs["depends_on"])
        return whole

    return pose


def test_the_points_of_the_nominal_scan_are_those_of_the_slice_files(
    scan: Path, tmp_path: Path
) -> None:
    h5py = pytest.importorskip("h5py")
    export_scan(scan, tmp_path / "vase.h5")
    with h5py.File(tmp_path / "vase.h5") as root:
        np.testing.assert_allclose(
            root["entry/points/points"][...], truth(scan)["points"], atol=1e-9
        )


@pytest.mark.parametrize("ending", ["nxs", "ply", "e57", "xyz", "las"])
def test_a_damaged_slice_is_left_out_and_told(scan: Path, tmp_path: Path, ending: str) -> None:
    import shutil

    shutil.copytree(scan, tmp_path / "vase.scan")
    whole = export_scan(scan, tmp_path / f"whole.{ending}")
    damage(tmp_path / "vase.scan", 4)
    done = export_scan(tmp_path / "vase.scan", tmp_path / f"vase.{ending}")
    assert [index for index, _ in done.left_out] == [4]
    assert (done.slices, whole.slices) == (9, 10)
    assert done.points == np.count_nonzero(truth(scan)["slice"] != 4) < whole.points


def test_what_cannot_be_written_leaves_nothing(scan: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ends in none of \.nxs"):
        export_scan(scan, tmp_path / "vase.step")
    empty = write_scan(tmp_path / "empty.scan", [], State.ABORTED)
    for ending in ("nxs", "ply", "e57", "xyz", "las"):
        with pytest.raises(ValueError, match="no slice of it has a measured point"):
            export_scan(empty, tmp_path / f"vase.{ending}")
    (tmp_path / "there.ply").write_bytes(b"mine")
    with pytest.raises(ValueError, match="is there already"):
        export_scan(scan, tmp_path / "there.ply")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["empty.scan", "there.ply"]


def test_a_library_that_is_not_there_is_said_with_its_remedy(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(ValueError, match=r"h5py is not installed; run: pip install"):
        export_scan(scan, tmp_path / "vase.nxs")
    assert not list(tmp_path.iterdir())
