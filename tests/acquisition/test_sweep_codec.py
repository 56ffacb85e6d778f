"""A sweep's bytes give the sweep back, or say that they are damaged."""

from __future__ import annotations

import hashlib
import io
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from acquisition.poses import Pose, Sweep
from acquisition.sweep_codec import decode_sweep, encode_sweep, has_checksum
from drivers.profiler import Profile
from tests.acquisition.scan_cases import assert_same_sweep, sweep

finite = st.floats(allow_nan=False, allow_infinity=False)
int64 = st.integers(-(2**63), 2**63 - 1)
widths = st.sampled_from([(-(2**15), 2**15 - 1), (0, 2**16 - 1), (-(2**31), 2**31 - 1)])


@st.composite
def profiles(draw: st.DrawFn) -> Profile:
    points = draw(st.integers(0, 6))
    low, high = draw(widths)
    return Profile(
        counts=draw(arrays(np.int32, (points, 2), elements=st.integers(low, high))),
        scale_mm=draw(st.tuples(finite, finite)),
        offset_mm=draw(st.tuples(finite, finite)),
        reasons=draw(arrays(np.uint8, points)),
        intensity=draw(arrays(np.uint16, draw(st.sampled_from([0, points])))),
        sensor_time_s=draw(finite),
        encoder=draw(int64),
        frame=draw(int64),
    )


@st.composite
def sweeps(draw: st.DrawFn) -> Sweep:
    taken = draw(st.lists(profiles(), max_size=4))
    poses = [Pose(draw(finite), draw(finite), draw(finite)) for _ in taken]
    return Sweep(draw(st.integers(0, 2**40)), tuple(taken), tuple(poses))


@settings(max_examples=50, deadline=None)
@given(sweeps())
def test_what_is_encoded_decodes_to_the_last_bit(taken: Sweep) -> None:
    assert_same_sweep(decode_sweep(encode_sweep(taken)), taken)


def test_the_same_sweep_gives_the_same_bytes() -> None:
    assert encode_sweep(sweep(4)) == encode_sweep(sweep(4))


@pytest.mark.parametrize(
    ("high", "dtype"), [(32767, "<i2"), (32768, "<u2"), (65535, "<u2"), (65536, "<i4")]
)
def test_counts_are_kept_as_narrow_as_they_fit(high: int, dtype: str) -> None:
    one = sweep(0, profiles=1).profiles[0]
    counts = np.abs(one.counts)
    counts[0, 1] = high
    wide = Profile(
        counts, *(getattr(one, name) for name in Profile.__dataclass_fields__ if name != "counts")
    )
    data = encode_sweep(Sweep(0, (wide,), (Pose(0.0, 0.0, 0.0),)))
    with np.load(io.BytesIO(data)) as columns:
        assert columns["z"].dtype == dtype
        assert columns["x"].dtype == "<i2"


def test_numpy_alone_reads_a_slice_file_as_the_document_says() -> None:
    taken = sweep(7)
    with np.load(io.BytesIO(encode_sweep(taken)), allow_pickle=False) as columns:
        second = slice(columns["lengths"][0], columns["lengths"][:2].sum())
        kept = columns["reasons"][second] == 0
        counts = np.column_stack([columns["x"], columns["z"]])[second][kept]
        points_mm = counts * columns["scale_mm"][1] + columns["offset_mm"][1]
        assert columns["index"] == 7
        assert columns["table_rad"][1] == taken.poses[1].table_rad
    np.testing.assert_array_equal(points_mm, taken.profiles[1].points_mm)


def test_decoded_arrays_are_read_only() -> None:
    one = decode_sweep(encode_sweep(sweep(1))).profiles[0]
    assert not any(a.flags.writeable for a in (one.counts, one.reasons, one.intensity))


def naive_encoding(taken: Sweep) -> bytes:
    """The same file by zipfile and numpy, the libraries that everybody reads it with."""
    stream, whole = io.BytesIO(encode_sweep(taken)), io.BytesIO()
    with zipfile.ZipFile(stream) as source, zipfile.ZipFile(whole, "w") as made:
        for name in source.namelist():
            member = io.BytesIO()
            column = np.lib.format.read_array(io.BytesIO(source.read(name)), allow_pickle=False)
            np.lib.format.write_array(member, column, version=(1, 0), allow_pickle=False)
            made.writestr(zipfile.ZipInfo(name), member.getvalue())
        made.comment = bytes(71)
    data = whole.getvalue()[:-71]
    return data + b"sha256:" + hashlib.sha256(data).hexdigest().encode()


@pytest.mark.parametrize(("profiles", "points"), [(0, 0), (1, 1), (3, 8), (40, 500)])
def test_the_archive_is_the_one_that_zipfile_would_write(profiles: int, points: int) -> None:
    taken = sweep(2, profiles, points)
    assert encode_sweep(taken) == naive_encoding(taken)
    with zipfile.ZipFile(io.BytesIO(encode_sweep(taken))) as archive:
        assert archive.testzip() is None


@pytest.mark.parametrize("bit", range(8))
def test_a_flipped_bit_is_noticed_wherever_it_is(bit: int) -> None:
    whole = encode_sweep(sweep(2))
    for place in range(bit, len(whole), 8):
        data = bytearray(whole)
        data[place] ^= 1 << bit
        with pytest.raises(ValueError, match=r"damaged|column|version"):
            decode_sweep(bytes(data))


def test_no_checksum_is_told_from_a_wrong_one_however_the_end_is_damaged() -> None:
    data = encode_sweep(sweep(2))
    for place in range(len(data) - 100, len(data)):
        for value in (0, 255):
            if data[place] != value:
                with pytest.raises(ValueError, match=r"damaged|column|version"):
                    decode_sweep(data[:place] + bytes([value]) + data[place + 1 :])


def test_a_file_of_before_there_were_checksums_decodes_and_is_told() -> None:
    data = encode_sweep(sweep(2))
    stream = io.BytesIO(data)
    with zipfile.ZipFile(stream, "a") as archive:
        archive.comment = b""
    old = stream.getvalue()
    assert has_checksum(data)
    assert not has_checksum(old)
    assert_same_sweep(decode_sweep(old), sweep(2))


def test_a_flipped_bit_in_any_column_is_noticed() -> None:
    data = encode_sweep(sweep(2))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        starts = [each.header_offset for each in archive.infolist()]
        sizes = [each.file_size for each in archive.infolist()]
    for start, size in zip(starts, sizes, strict=True):
        name_length = int.from_bytes(data[start + 26 : start + 28], "little")
        extra_length = int.from_bytes(data[start + 28 : start + 30], "little")
        damaged = bytearray(data)
        damaged[start + 30 + name_length + extra_length + size - 1] ^= 1
        with pytest.raises(ValueError, match="damaged archive: Bad CRC"):
            decode_sweep(bytes(damaged))


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_cut_file_is_damaged(share: float) -> None:
    data = encode_sweep(sweep(2))
    with pytest.raises(ValueError, match="damaged archive"):
        decode_sweep(data[: int(share * len(data))])


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=400))
def test_arbitrary_bytes_are_damaged_and_nothing_else(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"damaged|column"):
        decode_sweep(data)


def rewritten(name: str, column: np.ndarray) -> bytes:
    """A valid archive whose one column is another."""
    with np.load(io.BytesIO(encode_sweep(sweep(2)))) as columns:
        changed = {**columns, name: column}
    whole = io.BytesIO()
    np.savez(whole, **changed)
    return whole.getvalue()


@pytest.mark.parametrize(
    ("name", "column", "said"),
    [
        ("version", np.int64(2), "version 2, this program knows 1"),
        ("index", np.int64(-1), "index -1 is negative"),
        ("x", np.zeros(5, "<i2"), "column x is"),
        ("x", np.zeros(27, "<f8"), "column x is of float64"),
        ("lengths", np.array([-1, 20, 8], "<i4"), "negative length"),
        ("time_s", np.zeros(2), "column time_s is"),
        ("table_rad", np.zeros((3, 1)), "column table_rad is"),
        ("scale_mm", np.zeros((3, 3)), "column scale_mm is"),
        ("intensity", np.zeros(3, "<u2"), "column intensity is"),
    ],
)
def test_columns_that_do_not_fit_together_are_refused(
    name: str, column: np.ndarray, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        decode_sweep(rewritten(name, column))


def test_a_pickle_is_never_opened() -> None:
    whole = io.BytesIO()
    with np.load(io.BytesIO(encode_sweep(sweep(2)))) as columns:
        np.savez(whole, **{**columns, "x": np.array([{"a": 1}], dtype=object)})
    with pytest.raises(ValueError, match="OBJECT"):
        decode_sweep(whole.getvalue())


def test_a_sweep_has_one_pose_for_each_profile() -> None:
    taken = sweep(1)
    with pytest.raises(ValueError, match="3 profiles, 2 poses"):
        Sweep(1, taken.profiles, taken.poses[:2])
