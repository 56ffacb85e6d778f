"""Text: .xyz, .pts, .txt and .csv in every dialect, to the last bit."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.clouds import open_cloud
from reconstruction.errors import UnreadableCloud


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("text")


def read(path: Path, text: str | bytes, points: int = 1 << 20) -> tuple[list[list[float]], int]:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    chunks = list(open_cloud(path).chunks(points))
    return np.concatenate([chunk.points for chunk in chunks]).tolist(), sum(
        chunk.skipped for chunk in chunks
    )


def complaint(path: Path, text: str | bytes) -> str:
    with pytest.raises(UnreadableCloud) as caught:
        read(path, text)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


coordinates = st.floats(allow_nan=False, allow_infinity=False)
numerals = st.one_of(
    coordinates.map(repr),
    coordinates.map("{:.18e}".format),
    coordinates.map("{:+.3f}".format),
    st.integers(-(10**25), 10**25).map(str),
)


@st.composite
def texts(draw: st.DrawFn) -> tuple[str, list[list[float]], str]:
    dialects = {".xyz": [" "], ".txt": ["\t", " , "], ".pts": ["  "], ".csv": [",", ";"]}
    extension = draw(st.sampled_from(list(dialects)))
    delimiter = draw(st.sampled_from(dialects[extension]))
    newline = draw(st.sampled_from(["\n", "\r\n", " \n", "\n\n", "\n# note 1 2 3\n", "\n //\n"]))
    width = draw(st.integers(3, 6))
    row = st.lists(numerals, min_size=width, max_size=width)
    rows = draw(st.lists(row, min_size=1, max_size=20))
    names = [*draw(st.permutations(["X", "y", "z_mm"])), *(f"c{n}" for n in range(width - 3))]
    lead = draw(st.sampled_from(["", "# comment\n", "\n", "//X Y Z\n", "\ufeff"]))
    if delimiter in " \t" and draw(st.booleans()):
        lead += f"{len(rows)}\n"
    if draw(st.booleans()):
        lead += delimiter.join(names) + "\n"
        places = [names.index(name) for name in ("X", "y", "z_mm")]
    else:
        places = [0, 1, 2]
    end = draw(st.sampled_from(["", newline]))
    body = newline.join(delimiter.join(cells) for cells in rows)
    return lead + body + end, [[float(cells[at]) for at in places] for cells in rows], extension


@given(texts(), st.integers(1, 21))
@settings(max_examples=250, deadline=None)
def test_points_come_back_to_the_last_bit_in_every_dialect(
    folder: Path, written: tuple[str, list[list[float]], str], points: int
) -> None:
    text, expected, extension = written
    assert read(folder / f"any{extension}", text, points) == (expected, 0)


def test_long_files_come_back_across_blocks_and_chunks(folder: Path) -> None:
    values = np.random.default_rng(2).normal(0, 100, (60_000, 3))
    path = folder / "long.xyz"
    np.savetxt(path, values)  # 19 digits: every way of the numerals is used
    assert path.stat().st_size > 3 << 20
    for points in (1 << 20, 9_999):
        chunks = list(open_cloud(path).chunks(points))
        np.testing.assert_array_equal(np.concatenate([chunk.points for chunk in chunks]), values)


@pytest.mark.parametrize(
    "header",
    [
        "id,x,y,z",
        "ID,X [mm],Y [mm],Z [mm]",
        '"id","x","y","z"',
        "x_normal, x_mm, y_mm, z_mm",
        "id;X (µm);Y (µm);Z (µm)",
        "x cm,x,y,z",
    ],
)
def test_csv_columns_are_found_by_name(folder: Path, header: str) -> None:
    delimiter = ";" if ";" in header else ","
    row = delimiter.join(["9", "1", "2", "3"])
    assert read(folder / "named.csv", f"{header}\n{row}\n") == ([[1, 2, 3]], 0)


def test_names_with_units_are_found_between_blanks(folder: Path) -> None:
    assert read(folder / "a.txt", "Z [mm] Y [mm] X [mm]\n1 2 3\n") == ([[3, 2, 1]], 0)


def test_a_header_without_names_of_axes_means_the_first_three_columns(folder: Path) -> None:
    assert read(folder / "a.xyz", "east north up weight\n1 2 3 4\n") == ([[1, 2, 3]], 0)


def test_missing_nan_and_infinite_values_are_skipped_and_counted(folder: Path) -> None:
    text = "x,y,z\n1,2,3\n,2,3\n1,nan,3\n1,2,-inf\n1,2,\n4,5,6\n"
    assert read(folder / "a.csv", text) == ([[1, 2, 3], [4, 5, 6]], 4)


def test_a_promised_count_is_the_point_count(folder: Path) -> None:
    assert read(folder / "a.pts", "2\n1 2 3 99 0 0 0\n4 5 6 99 0 0 0\n")[1] == 0
    assert open_cloud(folder / "a.pts").point_count == 2
    read(folder / "b.pts", "1 2 3\n")
    assert open_cloud(folder / "b.pts").point_count is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3\n4 five 6\n7 8 9\n", "line 2: 'five' is not a number"),
        ("# a\n\n1 2 3\n4 5\n7 8 9\n", "line 4: 2 columns, 3 are needed: '4 5'"),
        ("1 2 3\n4 1_0 6\n7 8 9\n", "line 2: '1_0' is not a number"),
        ("1;2;3\n1,5;2;3\n", "line 2: '1,5' is not a number; write decimal points"),
        ("1,5 2,5 3,5\n1,5 2,5 3,5\n", "line 1: '5 2' is not a number"),
        ("1 2 3\n4 " + "8" * 50 + "x 6\n7 8 9\n", f"line 2: '{'8' * 24}...' is not a number"),
        ("1 2\n3 4\n", "line 1: 2 columns, x, y and z are needed"),
        ("x y z\n", "holds no row of numbers"),
        ("# only\n# comments\n", "holds no row of numbers"),
        ("3\n1 2 3\n4 5 6\n", "truncated: line 1 promises 3 points, 2 are there"),
        ("# a\n7\n", "truncated: line 2 promises 7 points, 0 are there"),
        ("1\n1 2 3\n4 5 6\n", "line 1 promises 1 points, more follow"),
        ("999999999999\n1 2 3\n", "truncated: line 1 promises 999 999 999 999 points"),
        ("1 2 3\n4 5 6\n7 8", "truncated: the last line, 3, breaks off: '7 8'"),
        ("1 2 3\n4 5 6\n7 8 9e", "truncated: the last line, 3, breaks off: '7 8 9e'"),
        ("1 2 3 4\n4 5 6 4\n7 8 9", "truncated: the last line, 3, breaks off: '7 8 9'"),
        ("1,2,3\n4,5,6\n7,8,", "truncated: the last line, 3, breaks off: '7,8,'"),
        ("nan nan nan\nnan 1 2\n", "none of its 2 points is finite"),
        ("\xff\xfe1\x002\x00", "holds no row"),
    ],
)
def test_a_damaged_file_says_what_is_wrong(folder: Path, text: str, said: str) -> None:
    assert said in complaint(folder / "a.xyz", text)


def test_a_csv_header_without_axes_is_refused_with_its_names(folder: Path) -> None:
    said = complaint(folder / "a.csv", "id,lat,lon,height\n1,2,3,4\n")
    assert "names no x, y and z: 'id, lat, lon, height'" in said


def test_a_header_of_other_width_than_its_rows_is_refused(folder: Path) -> None:
    said = complaint(folder / "a.csv", "x,y,z\n0,1,2,3\n")
    assert "line 2: 4 columns, the header names 3" in said


def test_utf16_text_is_named_as_such(folder: Path) -> None:
    assert "is UTF-16 text" in complaint(folder / "a.xyz", "1 2 3\n".encode("utf-16"))


def test_a_trailing_delimiter_of_every_row_is_no_truncation(folder: Path) -> None:
    assert read(folder / "a.csv", "1,2,3,\n4,5,6,") == ([[1, 2, 3], [4, 5, 6]], 0)


def test_an_endless_line_is_refused(folder: Path) -> None:
    assert "longer than 1 MB" in complaint(folder / "a.xyz", b"1 2 3\n" + b"1 " * (3 << 19))
