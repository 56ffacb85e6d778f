"""PLY: what a small writer of every encoding writes, comes back."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.clouds import Chunk, open_cloud
from reconstruction.errors import UnreadableCloud

NAMES = {
    "i1": ("char", "int8"), "u1": ("uchar", "uint8"), "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"), "i4": ("int", "int32"), "u4": ("uint", "uint32"),
    "f4": ("float", "float32"), "f8": ("double", "float64"),
}  # fmt: skip
ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]


@dataclass
class Written:
    """A table of the file: named columns, each a list of numbers or of lists of them."""

    name: str
    types: list[str]  # a numpy type, or "length type:item type"
    columns: dict[str, list]


def written_value(value: object, type_: str, encoding: str) -> bytes:
    if ":" in type_:
        length, item = type_.split(":")
        return written_value(len(value), length, encoding) + written_value(value, item, encoding)
    numbers = np.array(value, dtype=("<" if "little" in encoding else ">") + type_)
    if encoding == "ascii":
        return b"".join(f"{number!r} ".encode() for number in numbers.ravel().tolist())
    return numbers.tobytes()


def ply_bytes(tables: list[Written], encoding: str, newline: bytes = b"\n") -> bytes:
    header = ["ply", f"format {encoding} 1.0", "comment element vertex 7", "obj_info of a test"]
    body: list[bytes] = []
    for table in tables:
        rows = list(zip(*table.columns.values(), strict=True))
        header.append(f"element {table.name} {len(rows)}")
        for turn, (name, type_) in enumerate(zip(table.columns, table.types, strict=True)):
            words = [NAMES[part][turn % 2] for part in type_.split(":")]
            header.append(f"property {'list ' if ':' in type_ else ''}{' '.join(words)} {name}")
        for row in rows:
            values = zip(row, table.types, strict=True)
            body.extend(written_value(value, type_, encoding) for value, type_ in values)
            body.append(newline if encoding == "ascii" else b"")
    header.append("end_header")
    return newline.join(line.encode() for line in header) + newline + b"".join(body)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ply")


def all_points(chunks: list[Chunk]) -> np.ndarray:
    return np.concatenate([chunk.points for chunk in chunks])


scalar_types = st.sampled_from(list(NAMES))
list_types = st.builds(
    "{}:{}".format, st.sampled_from(["u1", "i1", "u2", "i4", "u4"]), scalar_types
)


@st.composite
def columns(draw: st.DrawFn, type_: str, count: int) -> list:
    def values(item: str, size: int) -> list:
        kind = np.dtype(item)
        if kind.kind == "f":
            return draw(st.lists(st.floats(-1e4, 1e4, width=32), min_size=size, max_size=size))
        limits = np.iinfo(kind)
        integers = st.integers(int(limits.min), int(limits.max))
        return draw(st.lists(integers, min_size=size, max_size=size))

    if ":" not in type_:
        return values(type_, count)
    return [values(type_.split(":")[1], draw(st.integers(0, 4))) for _ in range(count)]


@st.composite
def tables(draw: st.DrawFn, name: str, must_have: tuple[str, ...] = ()) -> Written:
    count = draw(st.integers(1 if must_have else 0, 12))
    extra = [f"extra{place}" for place in range(draw(st.integers(0, 4)))]
    names = draw(st.permutations([*must_have, *extra]))
    types = [draw(scalar_types if n in must_have else scalar_types | list_types) for n in names]
    drawn = {n: draw(columns(type_, count)) for n, type_ in zip(names, types, strict=True)}
    if not names:
        count = 0
    return Written(name, types, drawn)


@given(
    st.lists(tables("tristrips"), max_size=2),
    tables("vertex", ("x", "y", "z")),
    tables("face"),
    st.sampled_from(ENCODINGS),
    st.sampled_from([b"\n", b"\r\n"]),
    st.integers(1, 13),
)
@settings(max_examples=120, deadline=None)
def test_vertices_come_back_whatever_stands_around_them(
    folder: Path,
    before: list[Written],
    vertex: Written,
    after: Written,
    encoding: str,
    newline: bytes,
    points: int,
) -> None:
    path = folder / "any.ply"
    path.write_bytes(ply_bytes([*before, vertex, after], encoding, newline))
    cloud = open_cloud(path)
    chunks = list(cloud.chunks(points))
    expected = np.array([vertex.columns[axis] for axis in "xyz"], dtype=np.float64).T
    assert cloud.format == f"ply {encoding}"
    assert cloud.point_count == len(expected)
    assert all(len(chunk.points) <= points for chunk in chunks)
    np.testing.assert_array_equal(all_points(chunks), expected)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_records_with_lists_are_read_across_blocks(folder: Path, encoding: str) -> None:
    rng = np.random.default_rng(8)
    lists = [list(range(length)) for length in rng.integers(0, 200, 9000)]
    xyz = rng.normal(size=(3, 9000)).tolist()
    vertex = Written(
        "vertex",
        ["f8", "u1:i4", "f8", "f8"],
        {"x": xyz[0], "seen_by": lists, "y": xyz[1], "z": xyz[2]},
    )
    faces = Written("face", ["u2:u1"], {"ids": [[7] * 3000 for _ in range(500)]})
    path = folder / "lists.ply"
    path.write_bytes(ply_bytes([faces, vertex], encoding))
    assert path.stat().st_size > 4 << 20
    np.testing.assert_array_equal(
        all_points(list(open_cloud(path).chunks(1000))), np.transpose(xyz)
    )


def simple_vertices(count: int) -> Written:
    values = [float(value) for value in range(count)]
    return Written("vertex", ["f4", "f4", "f4"], {"x": values, "y": values, "z": values})


def complaint(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(UnreadableCloud) as caught:
        list(open_cloud(path).chunks())
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_a_truncated_binary_file_says_how_many_points_are_there(folder: Path) -> None:
    data = ply_bytes([simple_vertices(1200)], "binary_little_endian")
    said = complaint(folder / "cut.ply", data[:-7])
    assert "truncated: header promises 1 200 points, 1 199 are there" in said


def test_a_truncated_ascii_file_says_how_many_points_are_there(folder: Path) -> None:
    data = ply_bytes([simple_vertices(1200)], "ascii")
    last = len(data) - data.rindex(b"1199.0 1199.0 1199.0")
    for left in (14, 13, 8, 1, 0):  # bytes of the last line
        said = complaint(folder / "cut.ply", data[: left - last])
        assert "truncated: header promises 1 200 points, 1 199 are there" in said


def test_truncated_lists_before_and_in_the_vertices_are_told_apart(folder: Path) -> None:
    faces = Written("face", ["u1:i4"], {"ids": [[1, 2, 3]] * 4})
    vertex = Written(
        "vertex",
        ["f4", "f4", "f4", "u1:i4"],
        {"x": [1, 2], "y": [1, 2], "z": [1, 2], "l": [[], [5]]},
    )
    data = ply_bytes([vertex], "binary_big_endian")
    assert "promises 2 points, 1 are there" in complaint(folder / "a.ply", data[:-1])
    data = ply_bytes([faces, simple_vertices(1)], "binary_little_endian")
    assert "4 records of 'face', 3 are there" in complaint(folder / "b.ply", data[:-13])


def test_a_negative_list_length_is_damage(folder: Path) -> None:
    vertex = Written(
        "vertex", ["f4", "f4", "f4", "i1:i4"], {"x": [1], "y": [1], "z": [1], "l": [[]]}
    )
    data = ply_bytes([vertex], "binary_little_endian")
    assert "negative length" in complaint(folder / "a.ply", data[:-1] + b"\xff")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_absurd_count_is_refused_before_anything_is_read(folder: Path, encoding: str) -> None:
    data = ply_bytes([simple_vertices(3)], encoding)
    data = data.replace(b"vertex 3", b"vertex 999999999999999999")
    assert "header promises 999 999 999 999 999 999 points" in complaint(folder / "a.ply", data)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"ply", b"PK\3\4", "its first line is not 'ply'"),
        (b"end_header\n", b"", "no end_header"),
        (b"ascii 1.0", b"utf8 1.0", "line 2 of its header is 'format utf8 1.0'"),
        (b"format ascii 1.0\n", b"", "no format line"),
        (b"float x", b"floaty x", "line 6: no such property type: 'floaty x'"),
        (b"float x", b"list float int x", "line 6: the length of 'x' is no small integer"),
        (b"vertex 3", b"vertex -3", "line 5: the count of 'vertex' is '-3'"),
        (b"vertex 3", b"vortex 3", "no element 'vertex'"),
        (b"float32 y", b"float32 why", "no x, y and z"),
        (b"1.0 1.0 1.0", b"1.0 one 1.0", "line 11: 'one' is not a number"),
        (b"1.0 1.0 1.0", b"1.0 1.0", "line 11: 2 columns, 3 are needed: '1.0 1.0 '"),
    ],
)
def test_a_damaged_file_says_what_is_wrong(folder: Path, old: bytes, new: bytes, said: str) -> None:
    data = ply_bytes([simple_vertices(3)], "ascii").replace(b"comment element vertex 7", b"comment")
    assert old in data
    assert said in complaint(folder / "a.ply", data.replace(old, new, 1))
