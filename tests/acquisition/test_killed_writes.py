"""The campaign of killed, failed and forgotten writes, small; the whole of it is
``python -m tests.campaigns.killed_writes``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.campaigns.killed_writes import Tally, failures, kills, power_cuts
from tests.campaigns.power_loss import images
from tests.campaigns.tracing import Call, why_not

pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not())


@pytest.fixture
def memory() -> Iterator[Path]:
    shared = Path("/dev/shm")
    with TemporaryDirectory(dir=shared if os.access(shared, os.W_OK) else None) as folder:
        yield Path(folder)


def assert_well(tally: Tally, at_least: int) -> None:
    assert (tally.lost, tally.twice, tally.wrong) == (0, 0, [])
    assert sum(tally.cases.values()) >= at_least


def test_a_recorder_killed_at_every_write_and_rename_loses_nothing(memory: Path) -> None:
    tally = Tally()
    kills(memory, 2, "write", tally)
    kills(memory, 2, "rename", tally)
    assert_well(tally, 2 * 5)  # the record, its spare, two slices, the record's end


def test_every_state_that_a_power_cut_may_leave_has_what_was_told(memory: Path) -> None:
    tally = Tally()
    power_cuts(memory, 3, tally, ahead=2)  # so that names are made to last twice
    assert_well(tally, 100)


def test_a_recorder_that_never_syncs_is_caught_by_the_same_cuts(memory: Path) -> None:
    tally = Tally()
    power_cuts(memory, 3, tally, "careless")
    assert tally.lost > 0


@pytest.mark.parametrize("error", ["ENOSPC", "EIO"])
def test_a_disk_that_fails_at_any_write_is_named_and_keeps_what_was_told(
    memory: Path, error: str
) -> None:
    tally = Tally()
    failures(memory, 2, "write", error, tally)
    assert_well(tally, 5)


def test_the_forgetful_disk_forgets_what_posix_lets_it_forget() -> None:
    """Written out: a file renamed before it was synced may be empty under its new name."""
    made = [
        Call("openat", ("/d/.a.part",), flags="O_WRONLY|O_CREAT|O_TRUNC"),
        Call("write", ("/d/.a.part",), b"data"),
        Call("rename", ("/d/.a.part", "/d/a")),
    ]
    last = {dict(each.files).get("/d/a") for each in images(made, "/d") if each.call == 2}
    assert last == {None, b"", b"da", b"data"}
    synced = [*made[:2], Call("fsync", ("/d/.a.part",)), made[2], Call("fsync", ("/d",))]
    (end,) = [each for each in images(synced, "/d") if each.call == 4]
    assert end.files == (("/d/a", b"data"),)
