"""The .scan folder: slices are kept once, whole, and followed in order."""

from __future__ import annotations

import errno
import fcntl
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import AlreadyKept, DamagedSlice, NotAScan, ScanInUse, StorageFailed
from acquisition.scan_record import State, calibration_hash, decode_record, encode_record
from acquisition.scanfile import AHEAD, ScanFolder
from acquisition.settings import as_table
from acquisition.sweep_codec import encode_sweep
from tests.acquisition.scan_cases import KINEMATICS, REPOSITORY, assert_same_sweep, record, sweep


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "part.scan"


def written(path: Path, indices: list[int], state: State = State.ABORTED) -> ScanFolder:
    with ScanFolder.create(path, record()) as writer:
        for index in indices:
            writer.append(sweep(index))
        writer.finish(state)
    return ScanFolder.open(path)


def damage(file: Path) -> bytes:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x10
    file.write_bytes(bytes(data))
    return bytes(data)


def test_what_was_appended_is_read_back(path: Path) -> None:
    folder = written(path, [0, 1, 2, 3, 4], State.COMPLETE)
    assert folder.indices() == (0, 1, 2, 3, 4)
    for index in folder.indices():
        assert_same_sweep(folder.read(index), sweep(index))
    assert folder.verify().sound == (0, 1, 2, 3, 4)
    assert folder.record().state is State.COMPLETE


def test_two_scans_of_the_same_sweeps_are_the_same_bytes(tmp_path: Path) -> None:
    folders = [written(tmp_path / name, [0, 1]).path for name in ("a.scan", "b.scan")]
    for name in ("scan.json", "slices/000000.npz", "slices/000001.npz"):
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_scan_json_holds_station_plan_calibration_unit_and_frame(path: Path) -> None:
    document = json.loads((written(path, [0]).path / "scan.json").read_text())
    assert document["unit"] == "mm"
    assert document["frame"].startswith("part")
    assert document["slices"] == 5
    assert document["station"]["stage"]["screw_lead_mm"] == 5.0
    assert document["plan"]["ring"]["profiles_per_turn"] == 12
    assert document["calibration"]["sha256"] == calibration_hash(KINEMATICS)


def test_the_document_explains_every_key_and_column(path: Path) -> None:
    text = (REPOSITORY / "docs" / "scan-folder.md").read_text(encoding="utf-8")
    folder = written(path, [0])
    with np.load(folder.file(0)) as columns:
        names = [*json.loads((path / "scan.json").read_text()), *columns]
    assert [name for name in names if f"`{name}`" not in text] == []
    frames = (REPOSITORY / "docs" / "frames.md").read_text(encoding="utf-8")
    keys = [key for key in as_table(KINEMATICS) if key != "kind"]
    assert [key for key in keys if f"`{key}" not in frames] == []


def test_a_record_survives_its_bytes() -> None:
    assert decode_record(encode_record(record())) == record()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "other"}, "format is not"),
        ({"version": 2}, "version 2"),
        ({"unit": "inch"}, "'inch'"),
        ({"state": "done"}, "state: 'done'"),
        ({"calibration": {"values": {}}}, "calibration needs"),
        ({"station": []}, "must be objects"),
    ],
)
def test_a_wrong_scan_json_is_refused_in_one_line(
    path: Path, change: dict[str, object], said: str
) -> None:
    file = written(path, []).path / "scan.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(NotAScan, match=said) as refused:
        ScanFolder.open(path)
    assert "\n" not in str(refused.value)


def test_an_edited_calibration_does_not_pass_for_the_one_that_was_used(path: Path) -> None:
    file = written(path, []).path / "scan.json"
    document = json.loads(file.read_text())
    document["calibration"]["values"]["standoff_mm"] += 0.001
    file.write_text(json.dumps(document))
    with pytest.raises(NotAScan, match="hash"):
        ScanFolder.open(path)


def test_an_edited_plan_does_not_pass_for_the_one_that_was_scanned(path: Path) -> None:
    file = written(path, []).path / "scan.json"
    document = json.loads(file.read_text())
    document["plan"]["ring"]["step_mm"] = 2.0
    file.write_text(json.dumps(document))
    with pytest.raises(NotAScan, match="sha256"):
        ScanFolder.open(path)
    del document["sha256"]  # as in a scan.json of before there was one
    file.write_text(json.dumps(document))
    assert ScanFolder.open(path).record().plan.ring.step_mm == 2.0


def test_a_folder_without_scan_json_is_no_scan(tmp_path: Path) -> None:
    with pytest.raises(NotAScan, match=r"no scan\.json there"):
        ScanFolder.open(tmp_path)


@pytest.mark.parametrize("rest", ["scan.json", "slices/000000.npz", "holiday.jpg"])
def test_a_folder_that_holds_something_is_not_scanned_into(path: Path, rest: str) -> None:
    (path / rest).parent.mkdir(parents=True)
    (path / rest).write_bytes(b"precious")
    before = sorted(path.rglob("*"))
    with pytest.raises(FileExistsError, match="choose another name"):
        ScanFolder.create(path, record())
    assert sorted(path.rglob("*")) == before
    assert (path / rest).read_bytes() == b"precious"


def test_a_creation_that_was_cut_short_is_begun_again(path: Path) -> None:
    (path / "slices").mkdir(parents=True)
    (path / ".scan.json.part").write_bytes(b"{")
    (path / ".lock").write_bytes(b"1\n")
    assert written(path, [0]).indices() == (0,)


def test_a_slice_that_is_there_is_refused_and_stays(path: Path) -> None:
    with ScanFolder.create(path, record()) as writer:
        writer.append(sweep(2))
        before = writer.folder.file(2).read_bytes()
        for _ in range(2):
            with pytest.raises(AlreadyKept, match=r"000002\.npz"):
                writer.append(sweep(2, profiles=1))
        writer.append(sweep(3))
    assert writer.folder.file(2).read_bytes() == before
    assert writer.folder.indices() == (2, 3)


def test_a_slice_outside_the_plan_is_refused(path: Path) -> None:
    with ScanFolder.create(path, record(5)) as writer, pytest.raises(ValueError, match="ends at 4"):
        writer.append(sweep(5))


def test_a_closed_writer_keeps_nothing(path: Path) -> None:
    writer = ScanFolder.create(path, record())
    writer.finish(State.ABORTED)
    with pytest.raises(ValueError, match="closed"):
        writer.append(sweep(0))


def test_a_scan_with_slices_missing_is_not_complete(path: Path) -> None:
    with ScanFolder.create(path, record()) as writer:
        writer.append(sweep(0))
        with pytest.raises(ValueError, match="4 slices are missing"):
            writer.finish(State.COMPLETE)


def test_a_writer_left_unfinished_says_aborted(path: Path) -> None:
    def interrupted() -> None:
        with ScanFolder.create(path, record()) as writer:
            writer.append(sweep(0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert ScanFolder.open(path).record().state is State.ABORTED
    assert ScanFolder.open(path).indices() == (0,)


def test_resuming_takes_what_is_missing_and_nothing_twice(path: Path) -> None:
    folder = written(path, [0, 3])
    assert folder.missing() == (1, 2, 4)
    with folder.resume() as writer:
        assert folder.record().state is State.SCANNING
        for index in folder.missing():
            writer.append(sweep(index))
        writer.finish(State.COMPLETE)
    assert folder.verify().sound == (0, 1, 2, 3, 4)
    assert folder.missing() == ()


def test_resuming_a_complete_scan_leaves_it_complete(path: Path) -> None:
    folder = written(path, [0, 1, 2, 3, 4], State.COMPLETE)
    with folder.resume():
        assert folder.record().state is State.COMPLETE
    assert folder.record().state is State.COMPLETE


def test_files_under_work_are_ignored_and_removed_when_the_scan_is_resumed(path: Path) -> None:
    folder = written(path, [0])
    rests = [path / "slices" / ".000001.npz.part", path / ".scan.json.part"]
    for rest in rests:
        rest.write_bytes(b"half")
    assert folder.indices() == (0,)
    assert folder.verify().damaged == ()
    assert all(rest.exists() for rest in rests)
    with folder.resume():
        assert not any(rest.exists() for rest in rests)


def test_a_damaged_slice_is_named_and_read_by_nobody(path: Path) -> None:
    folder = written(path, [0, 1, 2])
    damage(folder.file(1))
    found = folder.verify()
    assert (found.sound, found.missing) == ((0, 2), (1, 3, 4))
    assert [each.file.name for each in found.damaged] == ["000001.npz"]
    with pytest.raises(DamagedSlice, match=r"000001\.npz: damaged archive.*resume the scan"):
        folder.read(1)


def test_a_slice_under_another_slices_name_is_damaged(path: Path) -> None:
    folder = written(path, [0, 1])
    folder.file(1).write_bytes(encode_sweep(sweep(0)))
    assert folder.verify().damaged[0].why == "it holds slice 0"


def test_damaged_slices_are_set_aside_under_new_names_and_taken_again(path: Path) -> None:
    folder = written(path, [0, 1])
    kept = []
    for _ in range(2):
        kept.append(damage(folder.file(1)))
        with folder.resume() as writer:
            assert [each.file.exists() for each in writer.set_aside] == [True]
            assert folder.missing()[0] == 1
            writer.append(sweep(1))
    names = ["000001.npz.damaged", "000001.npz.damaged2"]
    assert [(path / "slices" / name).read_bytes() for name in names] == kept
    assert folder.verify().sound == (0, 1)


def test_who_only_looks_at_the_lock_keeps_no_writer_out(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScanFolder.create(path, record()).close()
    with (path / ".lock").open() as looker:
        fcntl.flock(looker, fcntl.LOCK_SH)
        looked = lambda seconds: fcntl.flock(looker, fcntl.LOCK_UN)  # noqa: E731
        monkeypatch.setattr("acquisition.folder_lock.time.sleep", looked)
        with ScanFolder.open(path).resume() as writer:
            writer.append(sweep(0))


def test_a_second_program_cannot_append_and_is_told_who_does(path: Path) -> None:
    with ScanFolder.create(path, record()) as writer:
        writer.append(sweep(0))
        script = (
            "import sys; from pathlib import Path\n"
            "from acquisition.errors import ScanInUse\n"
            "from acquisition.scanfile import AHEAD, ScanFolder\n"
            "try: ScanFolder.open(Path(sys.argv[1])).resume()\n"
            "except ScanInUse as held: print(held)\n"
        )
        other = subprocess.run(
            [sys.executable, "-c", script, path],
            cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=True,
        )  # fmt: skip
        assert f"process {os.getpid()} is appending" in other.stdout
        with pytest.raises(ScanInUse, match=f"process {os.getpid()} "):
            writer.folder.resume()
    writer.folder.resume().close()


def test_a_failed_opening_lets_go_of_the_lock(path: Path) -> None:
    folder = written(path, [0])
    good = (path / "scan.json").read_bytes()
    (path / "scan.json").write_bytes(b"{")
    with pytest.raises(NotAScan):
        folder.resume()
    (path / "scan.json").write_bytes(good)
    folder.resume().close()


def never() -> bool:
    return False


def test_a_follower_gets_slices_in_order_as_they_appear(path: Path) -> None:
    writer = ScanFolder.create(path, record())
    script = iter(["append 1", "append 0", "append 2", "append 4", "append 3", "finish"])
    asked: list[float] = []

    def pause(seconds: float) -> None:
        asked.append(seconds)
        verb, *index = next(script).split()
        if verb == "append":
            writer.append(sweep(int(index[0])))
        else:
            writer.finish(State.COMPLETE)

    seen = [each.index for each in writer.folder.follow(pause, never)]
    assert seen == [0, 1, 2, 3, 4]
    assert len(asked) == 5  # the last slice needs no end to be seen
    assert max(asked) <= 0.05


def test_a_follower_of_an_ended_scan_never_waits_and_leaves_out_what_is_missing(path: Path) -> None:
    def pause(_: float) -> None:
        raise AssertionError("waited")

    folder = written(path, [0, 2, 3])
    assert [each.index for each in folder.follow(pause, never)] == [0, 2, 3]


def test_a_slice_that_comes_between_two_looks_of_the_follower_is_not_lost(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = ScanFolder.create(path, record(1))
    honest = ScanFolder.record

    def ends_while_the_follower_looks(folder: ScanFolder) -> object:
        if not folder.file(0).exists():
            writer.append(sweep(0))
            writer.finish(State.COMPLETE)
        return honest(folder)

    follower = writer.folder.follow(lambda _: None, never)
    monkeypatch.setattr(
        ScanFolder, "record", lambda folder: (honest(folder), monkeypatch.setattr(
            ScanFolder, "record", ends_while_the_follower_looks))[0],
    )  # fmt: skip
    assert [each.index for each in follower] == [0]


def test_a_follower_leaves_when_it_is_told_to(path: Path) -> None:
    with ScanFolder.create(path, record()) as writer:
        for index in (0, 1):
            writer.append(sweep(index))
        calls = itertools.count()
        follower = writer.folder.follow(lambda _: None, lambda: next(calls) >= 5)
        assert [each.index for each in follower] == [0, 1]
        assert [each.index for each in writer.folder.follow(lambda _: None, lambda: True)] == []


def test_a_follower_stops_at_a_damaged_slice_with_its_name(path: Path) -> None:
    folder = written(path, [0, 1])
    damage(folder.file(1))
    follower = folder.follow(lambda _: None, never)
    assert next(follower).index == 0
    with pytest.raises(DamagedSlice, match=r"000001\.npz"):
        next(follower)


@pytest.fixture
def failing_fsync(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """A list that counts down the fsyncs that still work once a number is put into it."""
    left: list[int] = []
    honest = os.fsync

    def fsync(descriptor: int) -> None:
        if left:
            left[0] -= 1
            if left[0] < 0:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
        honest(descriptor)

    monkeypatch.setattr("os.fsync", fsync)
    yield left
    left.clear()


@pytest.mark.parametrize(
    ("before", "working"),
    [(0, 0), (0, 1), (1, 0), (AHEAD, 0), (AHEAD, 1)],
    ids=["names", "first", "second", "next names", "first of the next"],
)
def test_a_slice_whose_fsync_failed_is_not_acknowledged(
    path: Path, failing_fsync: list[int], before: int, working: int
) -> None:
    with ScanFolder.create(path, record(AHEAD + 3)) as writer:
        for index in range(before):
            writer.append(sweep(index))
        failing_fsync.append(working)
        with pytest.raises(StorageFailed, match=r"part\.scan: keeping slice .*another disk"):
            writer.append(sweep(before))
        failing_fsync.clear()
        with pytest.raises(StorageFailed, match="resume"):
            writer.append(sweep(before + 1))
    folder = ScanFolder.open(path)
    assert set(range(before)) <= set(folder.verify().sound)
    assert folder.verify().damaged == ()
    assert not list((path / "slices").glob(".*"))
    with folder.resume() as writer:
        for index in folder.missing():
            writer.append(sweep(index))
    assert folder.verify().sound == tuple(range(AHEAD + 3))


def test_every_slice_is_synced_before_its_rename_under_a_name_that_lasts(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ScanFolder.create(path, record(AHEAD + 1)) as writer:
        told: list[str] = []
        honest_fsync, honest_replace = os.fsync, Path.replace

        def fsync(descriptor: int) -> None:
            told.append("folder" if os.path.isdir(f"/proc/self/fd/{descriptor}") else "file")  # noqa: PTH112
            honest_fsync(descriptor)

        def replace(self: Path, target: Path) -> Path:
            told.append("rename")
            return honest_replace(self, target)

        monkeypatch.setattr("os.fsync", fsync)
        monkeypatch.setattr(Path, "replace", replace)
        for index in range(AHEAD + 1):
            writer.append(sweep(index))
        batch = ["folder", *["file", "rename"] * AHEAD]
        assert told == [*batch, "folder", "file", "rename"]
        told.clear()
        writer.finish(State.COMPLETE)
        assert told[0] == "folder"
        monkeypatch.undo()
    assert not list(path.rglob(".*.part"))


def test_a_slice_whose_name_a_power_cut_took_is_found_by_a_resume(path: Path) -> None:
    folder = written(path, [0, 1])
    folder.file(1).rename(path / "slices/.ahead-6.part")
    (path / "slices/.ahead-5.part").write_bytes(b"")
    assert folder.missing() == (1, 2, 3, 4)
    with folder.resume() as writer:
        assert writer.folder.missing() == (2, 3, 4)
        assert folder.verify().sound == (0, 1)
    assert not list(path.rglob(".*.part"))


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.ENOSPC, "free some space"), (errno.EROFS, "read-only"), (errno.EACCES, "permission")],
)
def test_a_disk_that_takes_nothing_is_named_with_the_remedy(
    path: Path, monkeypatch: pytest.MonkeyPatch, number: int, remedy: str
) -> None:
    def write(_: int, data: bytes) -> int:
        if len(data) < 100:
            raise OSError(number, os.strerror(number))
        return honest(_, data[:50])  # no call takes all of it

    honest = os.write
    with ScanFolder.create(path, record()) as writer:
        writer.append(sweep(0))
        monkeypatch.setattr("os.write", write)
        with pytest.raises(StorageFailed, match=remedy) as failed:
            writer.append(sweep(1))
        monkeypatch.undo()
    assert failed.value.errno == number
    assert str(path) in str(failed.value)
    assert "\n" not in str(failed.value)
    assert ScanFolder.open(path).verify().sound == (0,)
    assert ScanFolder.open(path).record().state is State.ABORTED


def test_a_folder_that_cannot_be_made_is_said_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageFailed, match="creating the scan failed"):
        ScanFolder.create(tmp_path / "file" / "part.scan", record())
    with pytest.raises(FileExistsError, match="is a file"):
        ScanFolder.create(tmp_path / "file", record())
