"""Clouds: the door, the chunks, the memory, real scans, and bytes that are none."""

import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.clouds import EXTENSIONS, array_cloud, open_cloud
from reconstruction.clouds.source import shortened
from reconstruction.errors import UnreadableCloud

PLY = b"ply\nformat %s 1.0\nelement face 1\nproperty list uchar int i\nelement vertex 2\n\
property float x\nproperty float y\nproperty float z\nproperty list uchar uchar l\nend_header\n"
PCD = b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\n\
POINTS 2\nDATA %s\n"
SIX = np.arange(6, dtype="<f4").tobytes()
NPY = b"\x93NUMPY\x01\x00\x46\x00{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }".ljust(
    80
)
VALID = {
    ".ply": [
        PLY % b"ascii" + b"2 0 1\n1 2 3 1 7\n4 5 6 0\n",
        PLY % b"binary_little_endian"
        + b"\1"
        + bytes(4)
        + (SIX[:12] + b"\1\7")
        + (SIX[12:] + b"\0"),
    ],
    ".pcd": [
        PCD % b"ascii" + b"1 2 3\n4 5 6\n",
        PCD % b"binary" + SIX,
        PCD % b"binary_compressed" + b"\x19\0\0\0\x18\0\0\0" + b"\x17" + SIX,
    ],
    ".csv": [b"x,y,z\n1,2,3\n4,5,6\n"],
    ".pts": [b"2\n1 2 3\n4 5 6\n"],
    ".xyz": [b"# c\n1;2;3\n4;5;6e-3\n"],
    ".txt": [b"1 2 3\n4 5 6\n"],
    ".npy": [NPY + SIX],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("clouds")


@pytest.fixture
def scans() -> Path:
    default = Path(__file__).parents[2].parent / "shared" / "data"
    path = Path(os.environ.get("LOFTSCAN_DATA", default)) / "scans"
    if not path.is_dir():
        pytest.skip("no test data: LOFTSCAN_DATA is unset and ../shared/data is not there")
    return path


@pytest.mark.parametrize(
    ("name", "format_", "count"),
    [
        ("UHU.pcd", "pcd ascii", 20_147),
        ("cup.pcd", "pcd ascii", 14_964),
        ("bigCub.pts", "pts", 2_716),
        ("fabscanpi_duck.ply", "ply binary_little_endian", 52_782),
    ],
)
def test_a_real_scan_has_all_its_points(scans: Path, name: str, format_: str, count: int) -> None:
    cloud = open_cloud(scans / name)
    chunks = list(cloud.chunks(10_000))
    points = np.concatenate([chunk.points for chunk in chunks])
    assert (cloud.format, len(points)) == (format_, count)
    assert cloud.point_count in (count, None)
    assert sum(chunk.skipped for chunk in chunks) == 0
    if cloud.format != "ply binary_little_endian":
        skipped = 11 if name.endswith(".pcd") else 0
        expected = np.loadtxt(scans / name, skiprows=skipped, usecols=(0, 1, 2))
        np.testing.assert_array_equal(points, expected)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_every_sample_of_the_fuzz_test_is_a_cloud_of_two_points(
    folder: Path, extension: str
) -> None:
    for data in VALID[extension]:
        path = folder / f"valid{extension.upper()}"
        path.write_bytes(data)
        cloud = open_cloud(str(path))
        first, again = (
            np.concatenate([chunk.points for chunk in cloud.chunks(size)]) for size in (1, 5)
        )
        assert first.shape == (2, 3)
        np.testing.assert_array_equal(first, again)


@st.composite
def damaged(draw: st.DrawFn) -> tuple[str, bytes]:
    extension = draw(st.sampled_from(EXTENSIONS))
    data = bytearray(draw(st.sampled_from([*VALID[extension], b""])))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data)))
        new = draw(
            st.one_of(st.binary(max_size=4), st.sampled_from([b"9" * 17, b"-1", b"\n", b"nan"]))
        )
        data[at : at + draw(st.integers(0, 6))] = new
    return extension, bytes(data)


@given(damaged())
@settings(max_examples=600, deadline=None)
def test_any_bytes_are_points_or_an_unreadable_cloud(folder: Path, case: tuple[str, bytes]) -> None:
    extension, data = case
    path = folder / f"fuzz{extension}"
    path.write_bytes(data)
    chunks, said = [], ""
    try:
        chunks = list(open_cloud(path).chunks(3))
    except UnreadableCloud as error:
        said = str(error)
    assert chunks or said.startswith(f"{path}: ")
    assert len(said.splitlines()) <= 1
    for chunk in chunks:
        assert 1 <= len(chunk.points) <= 3
        assert np.isfinite(chunk.points).all()


@given(
    st.lists(st.sampled_from([0.0, 1.5, np.nan, np.inf, 1e308]), min_size=3, max_size=60),
    st.integers(1, 21),
)
@settings(max_examples=150, deadline=None)
def test_no_row_is_lost_uncounted_and_no_chunk_is_empty(values: list[float], points: int) -> None:
    rows = np.array(values[: len(values) // 3 * 3]).reshape(-1, 3)
    finite = rows[np.isfinite(rows).all(axis=1)]
    cloud = array_cloud(rows)
    if len(finite) == 0:
        with pytest.raises(UnreadableCloud, match=f"none of its {len(rows)} points is finite"):
            list(cloud.chunks(points))
        return
    chunks = list(cloud.chunks(points))
    assert all(1 <= len(chunk.points) <= points for chunk in chunks)
    assert sum(chunk.skipped for chunk in chunks) == len(rows) - len(finite)
    np.testing.assert_array_equal(np.concatenate([chunk.points for chunk in chunks]), finite)


def test_an_array_is_a_cloud_of_its_own() -> None:
    array = np.arange(12, dtype=np.int16).reshape(4, 3)
    cloud = array_cloud(array)
    array[:] = 0
    (chunk,) = cloud.chunks()
    assert (cloud.path, cloud.format, cloud.point_count) == (None, "array", 4)
    assert chunk.points.tolist() == np.arange(12).reshape(4, 3).tolist()
    assert not chunk.points.flags.writeable


@pytest.mark.parametrize(
    "wrong", [np.zeros((3, 2)), np.zeros(3), np.zeros((2, 3), complex), [["a", "b", "c"]]]
)
def test_an_array_that_is_no_cloud_is_the_callers_mistake(wrong: object) -> None:
    with pytest.raises(ValueError, match=r"shape \(n, 3\)|real numbers"):
        array_cloud(wrong)


def test_chunks_of_no_points_are_the_callers_mistake() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        array_cloud([[1, 2, 3]]).chunks(0)


def test_what_is_no_readable_file_says_so(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "empty.ply").touch()
    (tmp_path / "cloud.docx").write_text("1 2 3")
    os.mkfifo(tmp_path / "pipe.xyz")
    expected = {
        "missing.ply": "there is no such file",
        "folder.ply": "is a folder",
        "empty.ply": "the file is empty",
        "cloud.docx": "unknown extension '.docx'; convert it to one of .ply .pcd",
        "pipe.xyz": "is no regular file",
        "x" * 300 + ".ply": "name too long",
    }
    for name, said in expected.items():
        with pytest.raises(UnreadableCloud, match=f"(?i){name}: .*{said}"):
            open_cloud(tmp_path / name)


def test_a_file_without_permission_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\n")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")  # root, as CI often is, may read anything

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(UnreadableCloud, match=r"a\.xyz: no permission to read it"):
        open_cloud(tmp_path / "a.xyz")


@pytest.mark.parametrize("extension", [".npy", ".ply", ".pcd", ".xyz"])
def test_a_file_that_shrinks_between_two_passes_is_an_error(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"a{extension}"
    path.write_bytes(VALID[extension][-1])
    cloud = open_cloud(path)
    assert len(list(cloud.chunks())) == 1
    path.write_bytes(VALID[extension][-1][:-3])
    with pytest.raises(UnreadableCloud, match=r"truncated|packed data"):
        list(cloud.chunks())


def big_file(path: Path, kind: str) -> None:
    """Two million points, written in pieces so that the writing needs no memory."""
    piece = np.random.default_rng(1).uniform(0, 9, (100_000, 3)).astype("<f4")
    if kind == "pcd binary_compressed":
        head = PCD.replace(b" 2\n", b" 2000000\n") % b"binary_compressed"
        runs = np.hstack([np.full((37_500, 1), 31, np.uint8), piece.view(np.uint8).reshape(-1, 32)])
        head += (20 * runs.size).to_bytes(4, "little") + (20 * piece.nbytes).to_bytes(4, "little")
        body = runs.tobytes()
    elif kind == "xyz":
        head, body = b"", b"".join(b"%.4f %.4f %.4f\n" % tuple(row) for row in piece.tolist())
    else:
        head = b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000\nproperty float x\n"
        head += b"property float y\nproperty float z\nend_header\n"
        body = piece.tobytes()
    with path.open("wb") as file:
        file.write(head)
        for _ in range(20):
            file.write(body)


@pytest.mark.parametrize("kind", ["ply binary_little_endian", "pcd binary_compressed", "xyz"])
def test_memory_is_bounded_by_the_chunk_not_by_the_file(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"big.{kind.split()[0]}"
    big_file(path, kind)
    sum(len(chunk.points) for chunk in open_cloud(path).chunks(1000) if chunk.skipped)  # compile
    points = 1 << 15
    tracemalloc.start()
    count = sum(len(chunk.points) for chunk in open_cloud(path).chunks(points))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 2_000_000
    chunk_bytes = points * 24
    assert peak < 4 * chunk_bytes + (5 << 20)  # a few chunks, and blocks of the file
    assert peak < path.stat().st_size / 2


def test_foreign_bytes_are_shown_short_and_on_one_line() -> None:
    assert shortened(b"\xff\n\0abc") == r"'\\xff\n\x00abc'"
    assert shortened(b"7" * 30) == f"'{'7' * 24}...'"
