"""NPY: what numpy.save writes, comes back."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.clouds import open_cloud
from reconstruction.errors import UnreadableCloud

TYPES = ["<f8", ">f8", "<f4", ">f4", "<f2", "<i8", ">i4", "<i2", "|i1", "|u1", ">u2", "<u4", "<f16"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("npy")


@given(
    st.sampled_from(TYPES),
    st.sampled_from("CF"),
    st.integers(1, 50),
    st.integers(3, 6),
    st.integers(1, 51),
)
@settings(max_examples=120, deadline=None)
def test_arrays_of_every_type_and_order_come_back(
    folder: Path, dtype: str, order: str, count: int, columns: int, points: int
) -> None:
    values = np.random.default_rng(count).uniform(0, 100, (count, columns))
    array = np.asarray(values.astype(dtype), order=order)
    np.save(folder / "any.npy", array)
    cloud = open_cloud(folder / "any.npy")
    found = np.concatenate([chunk.points for chunk in cloud.chunks(points)])
    assert cloud.point_count == count
    assert cloud.format == f"npy {array.dtype.name}"
    np.testing.assert_array_equal(found, array[:, :3].astype(np.float64))


def complaint(path: Path) -> str:
    with pytest.raises(UnreadableCloud) as caught:
        list(open_cloud(path).chunks())
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((4, 2)), "it has 2 columns; x, y and z are needed"),
        (np.zeros(12), "its shape is '12,'"),
        (np.zeros((2, 2, 3)), "its shape is '2, 2, 3'"),
        (np.zeros((2, 3), complex), "its values are '<c16'"),
        (np.zeros((2, 3), "U4"), "its values are '<U4'"),
        (np.zeros(3, [("x", float), ("y", float)]), "its values are"),
        (np.zeros((0, 3)), "holds no points"),
        (np.full((3, 3), np.nan), "none of its 3 points is finite"),
    ],
)
def test_arrays_that_are_no_clouds_say_why(folder: Path, array: np.ndarray, said: str) -> None:
    np.save(folder / "a.npy", array)
    assert said in complaint(folder / "a.npy")


def test_a_pickle_is_never_opened(folder: Path) -> None:
    np.save(folder / "a.npy", np.array([[{}, 1, 2]], dtype=object), allow_pickle=True)
    assert "its values are '|O'" in complaint(folder / "a.npy")


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_truncated_array_says_how_many_points_are_there(folder: Path, order: str) -> None:
    np.save(folder / "a.npy", np.zeros((1000, 3), order=order))
    data = (folder / "a.npy").read_bytes()
    (folder / "a.npy").write_bytes(data[:-1])
    assert "truncated: header promises 1 000 points, 999 are there" in complaint(folder / "a.npy")


def test_what_is_no_array_file_or_half_a_header_is_refused(folder: Path) -> None:
    (folder / "a.npy").write_bytes(b"\x93NUMPX\1\0")
    assert "is no .npy file" in complaint(folder / "a.npy")
    np.save(folder / "a.npy", np.zeros((5, 3)))
    data = (folder / "a.npy").read_bytes()
    (folder / "a.npy").write_bytes(data.replace(b"(5, 3)", b"(\n, 3)"))
    assert "its shape is '\\n, 3'" in complaint(folder / "a.npy")
    np.save(folder / "a.npy", np.zeros((5, 3)))
    (folder / "a.npy").write_bytes((folder / "a.npy").read_bytes()[:40])
    assert "its array header promises 128 bytes, 40 are there" in complaint(folder / "a.npy")
