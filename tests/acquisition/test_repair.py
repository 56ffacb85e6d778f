"""A repair deletes nothing, rebuilds only what is proven, and leaves a folder that can go on."""

from __future__ import annotations

import io
import json
import random
import zipfile
from pathlib import Path

import pytest

from acquisition.errors import NotAScan, ScanInUse
from acquisition.repair import repair
from acquisition.salvage import salvaged
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from acquisition.sweep_codec import decode_sweep, encode_sweep
from tests.acquisition.scan_cases import assert_same_sweep, record, sweep


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A scan of five slices whose program died with four of them kept."""
    path = tmp_path / "part.scan"
    writer = ScanFolder.create(path, record())
    for index in (0, 1, 2, 3):
        writer.append(sweep(index))
    writer.close()
    return path


def flipped(file: Path, place: int) -> bytes:
    data = bytearray(file.read_bytes())
    data[place] ^= 0x20
    file.write_bytes(bytes(data))
    return bytes(data)


def contents(path: Path) -> set[bytes]:
    return {each.read_bytes() for each in path.rglob("*") if each.is_file()}


def test_a_sound_folder_is_left_as_it_is_but_for_its_state(path: Path) -> None:
    before = {each.name: each.read_bytes() for each in path.glob("slices/*")}
    done = repair(path)
    assert [each.done for each in done.mendings] == ["state: scanning is now aborted"]
    assert {each.name: each.read_bytes() for each in path.glob("slices/*")} == before
    assert (done.left.sound, done.left.missing) == ((0, 1, 2, 3), (4,))
    assert repair(path).mendings == ()


def test_a_scan_whose_program_died_after_its_last_slice_is_complete(path: Path) -> None:
    writer = ScanFolder.open(path).resume()
    writer.append(sweep(4))
    writer.close()
    assert [each.done for each in repair(path).mendings] == ["state: scanning is now complete"]
    assert ScanFolder.open(path).record().state is State.COMPLETE


def test_a_slice_whose_columns_are_damaged_is_set_aside_and_missing(path: Path) -> None:
    file = ScanFolder(path).file(2)
    damaged = flipped(file, file.read_bytes().index(b"reasons.npy") + 145)
    assert salvaged(damaged) is None
    done = repair(path)
    assert done.mendings[0].file.name == "000002.npz.damaged"
    assert done.mendings[0].file.read_bytes() == damaged
    assert done.left.missing == (2, 4)


@pytest.mark.parametrize("cut", [20, 71, 90, 500])
def test_a_slice_that_lost_its_end_is_rebuilt_from_its_columns(path: Path, cut: int) -> None:
    file = ScanFolder(path).file(2)
    whole = file.read_bytes()
    file.write_bytes(whole[:-cut])
    done = repair(path)
    assert [each.file.name for each in done.mendings[:2]] == ["000002.npz.damaged", "000002.npz"]
    assert file.read_bytes() == whole
    assert done.left.missing == (4,)


def test_what_is_salvaged_is_what_was_written_wherever_a_byte_was_changed() -> None:
    whole, taken = encode_sweep(sweep(2)), sweep(2)
    rebuilt = 0
    for place in range(len(whole)):
        data = bytearray(whole)
        data[place] ^= 0x41
        with pytest.raises(ValueError, match=r"damaged|column|version"):
            decode_sweep(bytes(data))
        found = salvaged(bytes(data))
        if found is not None:
            rebuilt += 1
            assert_same_sweep(found, taken)
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        columns = sum(each.file_size for each in archive.infolist())
    # Every byte outside the columns' own is told twice or not needed.
    assert rebuilt == len(whole) - columns


@pytest.mark.parametrize("seed", range(20))
def test_several_changed_bytes_give_the_sweep_or_nothing(seed: int) -> None:
    rng = random.Random(seed)
    data = bytearray(encode_sweep(sweep(2)))
    for _ in range(rng.randrange(1, 9)):
        data[rng.randrange(len(data))] = rng.randrange(256)
    found = salvaged(bytes(data[: rng.randrange(len(data) // 2, len(data))]))
    if found is not None:
        assert_same_sweep(found, sweep(2))


def test_a_slice_under_a_wrong_name_gets_its_own(path: Path) -> None:
    folder = ScanFolder(path)
    data = folder.file(3).read_bytes()
    folder.file(3).rename(folder.file(4))
    done = repair(path)
    assert folder.file(3).read_bytes() == data
    assert done.left.sound == (0, 1, 2, 3)
    folder.file(1).write_bytes(data)
    assert repair(path).left.missing == (1, 4)


def test_a_slice_that_was_whole_when_its_program_died_is_kept_and_a_half_one_set_aside(
    path: Path,
) -> None:
    slices = path / "slices"
    (slices / ".000004.npz.part").write_bytes(encode_sweep(sweep(4)))
    assert repair(path).left.missing == ()
    (slices / ".000003.npz.part").write_bytes(encode_sweep(sweep(3))[:900])
    done = repair(path)
    assert done.mendings[0].file.name == "000003.npz.part.damaged"
    assert not list(slices.glob(".*"))


def test_scan_json_is_rebuilt_from_its_spare_and_the_spare_from_it(path: Path) -> None:
    good = ScanFolder.open(path).record()
    flipped(path / "scan.json", 300)
    with pytest.raises(NotAScan, match="loftscan scans repair"):
        ScanFolder.open(path)
    done = repair(path)
    assert [each.file.name for each in done.mendings[:2]] == ["scan.json.damaged", "scan.json"]
    assert ScanFolder.open(path).record() == ScanFolder.open(path).record()
    assert ScanFolder.open(path).record().station == good.station
    (path / "scan.spare.json").unlink()
    assert [each.file.name for each in repair(path).mendings] == ["scan.spare.json"]
    (path / "scan.json").unlink()
    repair(path)
    assert ScanFolder.open(path).record().state is State.ABORTED


def test_without_both_nothing_is_changed(path: Path) -> None:
    (path / "scan.json").write_text("{")
    (path / "scan.spare.json").write_text("{")
    before = contents(path)
    with pytest.raises(NotAScan, match=r"spare.* nothing was changed"):
        repair(path)
    assert before <= contents(path)
    assert sorted(each.name for each in path.iterdir()) == [
        ".lock",
        "scan.json",
        "scan.spare.json",
        "slices",
    ]


def test_nothing_is_ever_deleted(path: Path) -> None:
    rng = random.Random(1)
    for _ in range(6):
        file = rng.choice(sorted(path.glob("slices/*.npz")))
        flipped(file, rng.randrange(len(file.read_bytes())))
        before = contents(path / "slices")
        repair(path)
        assert before <= contents(path / "slices")


def test_a_folder_that_a_program_appends_to_is_not_repaired(path: Path) -> None:
    with ScanFolder.open(path).resume(), pytest.raises(ScanInUse, match="is appending"):
        repair(path)


def test_a_folder_that_is_no_scan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotAScan, match=r"no scan\.json"):
        repair(tmp_path)


def test_a_repaired_scan_can_be_finished(path: Path) -> None:
    flipped(ScanFolder(path).file(0), 5)
    (ScanFolder(path).file(1)).write_bytes(b"")
    left = repair(path).left
    assert left.missing == (1, 4)
    with ScanFolder.open(path).resume() as writer:
        for index in writer.folder.missing():
            writer.append(sweep(index))
        writer.finish(State.COMPLETE)
    assert json.loads((path / "scan.json").read_text())["state"] == "complete"
