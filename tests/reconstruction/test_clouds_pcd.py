"""PCD: what a small writer of every encoding writes, comes back."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.clouds import open_cloud
from reconstruction.errors import UnreadableCloud

ENCODINGS = ["ascii", "binary", "binary_compressed"]
TYPES = ["f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"]
Column = tuple[str, np.ndarray]  # a field's name and its values, (n, count)


def literal_lzf(data: bytes) -> bytes:
    """Pack with literals, and with one reference where a byte repeats; see test_clouds_lzf.py."""
    out = bytearray()
    for first in range(0, len(data), 32):
        run = data[first : first + 32]
        if len(run) >= 12 and len(set(run)) == 1:
            out.extend([0, run[0], 7 << 5, len(run) - 1 - 9, 0])
        else:
            out.append(len(run) - 1)
            out.extend(run)
    return bytes(out)


def pcd_bytes(columns: Sequence[Column], encoding: str, height: int = 1) -> bytes:
    values = [value for _, value in columns]
    count = len(values[0])
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _ in columns),
        "SIZE " + " ".join(str(value.itemsize) for value in values),
        "TYPE " + " ".join(value.dtype.kind.upper() for value in values),
        "COUNT " + " ".join(str(value.shape[1]) for value in values),
        f"WIDTH {count // height}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        f"DATA {encoding}",
    ]
    if encoding == "ascii":
        rows = zip(*(value.tolist() for value in values), strict=True)
        lines = (" ".join(repr(n) for part in row for n in part) for row in rows)
        body = "".join(line + "\n" for line in lines).encode()
    elif encoding == "binary":
        parts = zip(*values, strict=True)
        body = b"".join(part.tobytes() for row in parts for part in row)
    else:
        whole = b"".join(value.tobytes() for value in values)
        packed = literal_lzf(whole)
        body = struct.pack("<II", len(packed), len(whole)) + packed
    return "".join(line + "\n" for line in header).encode() + body


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pcd")


def points_of(path: Path, points: int = 1 << 20) -> np.ndarray:
    return np.concatenate([chunk.points for chunk in open_cloud(path).chunks(points)])


@st.composite
def clouds(draw: st.DrawFn) -> list[Column]:
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    count = draw(st.integers(1, 40))
    extra = draw(st.lists(st.sampled_from(["rgb", "_", "normal_x", "label"]), max_size=3))
    columns = []
    for name in draw(st.permutations(["x", "y", "z", *extra])):
        size = 1 if name in "xyz" else draw(st.integers(1, 3))
        numbers = rng.uniform(0, 100, (count, size)) * draw(st.sampled_from([0, 1]))
        columns.append((name, numbers.astype(draw(st.sampled_from(TYPES)))))
    return columns


@given(clouds(), st.sampled_from(ENCODINGS), st.integers(1, 41))
@settings(max_examples=150, deadline=None)
def test_points_come_back_whatever_the_fields(
    folder: Path, columns: list[Column], encoding: str, points: int
) -> None:
    path = folder / "any.pcd"
    path.write_bytes(pcd_bytes(columns, encoding))
    cloud = open_cloud(path)
    found = dict(reversed(columns))
    expected = np.hstack([found[axis].astype(float) for axis in "xyz"])
    assert cloud.format == f"pcd {encoding}"
    assert cloud.point_count == len(expected)
    np.testing.assert_array_equal(points_of(path, points), expected)


def cloud_of(count: int) -> list[Column]:
    rng = np.random.default_rng(count)
    columns = [(axis, rng.normal(size=(count, 1)).astype("f4")) for axis in "zyx"]
    return [("rgb", np.zeros((count, 1), "u4")), *columns]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("points", [1 << 20, 70_001])
def test_a_long_cloud_comes_back_across_blocks(folder: Path, encoding: str, points: int) -> None:
    columns = cloud_of(150_000)
    path = folder / "long.pcd"
    path.write_bytes(pcd_bytes(columns, encoding, height=300))
    expected = np.hstack([dict(columns)[axis].astype(float) for axis in "xyz"])
    np.testing.assert_array_equal(points_of(path, points), expected)


def test_an_organised_cloud_counts_its_nan_points(folder: Path) -> None:
    columns = cloud_of(1000)
    for _, values in columns[1:]:
        values[100:350] = np.nan
    for encoding in ENCODINGS:
        path = folder / "organised.pcd"
        path.write_bytes(pcd_bytes(columns, encoding, height=10))
        chunks = list(open_cloud(path).chunks(60))
        assert sum(chunk.skipped for chunk in chunks) == 250
        assert sum(len(chunk.points) for chunk in chunks) == 750


def complaint(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(UnreadableCloud) as caught:
        list(open_cloud(path).chunks())
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_a_truncated_file_says_how_much_is_there(folder: Path) -> None:
    path, columns = folder / "cut.pcd", cloud_of(2000)
    assert "promises 2 000 points, 1 999 are there" in complaint(
        path, pcd_bytes(columns, "ascii").rsplit(b" ", 1)[0]
    )
    assert "promises 2 000 points, 1 999 are there" in complaint(
        path, pcd_bytes(columns, "binary")[:-1]
    )
    data = pcd_bytes(columns, "binary_compressed")
    assert "packed bytes" in complaint(path, data[:-1])


def test_packed_data_that_end_early_or_lie_about_their_size_are_refused(folder: Path) -> None:
    path, data = folder / "lie.pcd", pcd_bytes(cloud_of(200), "binary_compressed")
    body = data.index(b"compressed\n") + 11
    packed, whole = struct.unpack("<II", data[body : body + 8])
    shorter = struct.pack("<II", packed - 33 * 30, whole)
    assert "end before the last point" in complaint(path, data[:body] + shorter + data[body + 8 :])
    cut = struct.pack("<II", packed - 5, whole)
    assert "break off" in complaint(path, data[:body] + cut + data[body + 8 :])
    lie = struct.pack("<II", packed, whole + 1)
    assert "say they are 3 201" in complaint(path, data[:body] + lie + data[body + 8 :])


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_absurd_count_is_refused_before_anything_is_read(folder: Path, encoding: str) -> None:
    data = pcd_bytes(cloud_of(7), encoding)
    data = data.replace(b"POINTS 7", b"POINTS 9000000000").replace(b"WIDTH 7", b"WIDTH 9000000000")
    assert "header promises 9 000 000 000 points" in complaint(folder / "a.pcd", data)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"# .PCD", b"\x89PNG", "is no .pcd file, line 1 of its header is"),
        (b"DATA ascii\n", b"", "is no .pcd file, line 11 of its header"),
        (b"DATA ascii", b"DATA zip", "its data are 'zip'"),
        (b"SIZE 4 4 4 4", b"SIZE 4 4 4", "of different length"),
        (b"TYPE U F", b"TYPE U Q", "field 'z' has no known type: 'Q4'"),
        (b"COUNT 1 1", b"COUNT 1 2", "no single x, y and z"),
        (b"COUNT 1 1", b"COUNT 99999999999 1", "points of 400 000 000 008 bytes each"),
        (b"COUNT 1 1", b"COUNT 1 -1", "the COUNT of field 'z' is '-1'"),
        (b"rgb z", b"rgb w", "no single x, y and z"),
        (b"WIDTH 5", b"WIDTH 6", "says 5 points, but WIDTH x HEIGHT is 6"),
        (b"POINTS 5", b"POINTS five", "POINTS is 'five'"),
        (b"\n0 ", b"\n0 north", "line 12: 'north"),
    ],
)
def test_a_damaged_file_says_what_is_wrong(folder: Path, old: bytes, new: bytes, said: str) -> None:
    data = pcd_bytes(cloud_of(5), "ascii")
    assert old in data
    assert said in complaint(folder / "a.pcd", data.replace(old, new, 1))


def test_more_rows_than_promised_are_an_error_and_not_dropped(folder: Path) -> None:
    data = pcd_bytes(cloud_of(5), "ascii")
    assert "promises 5 points, more follow" in complaint(folder / "a.pcd", data + b"0 1 2 3\n")
