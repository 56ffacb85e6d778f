"""The child that writes STEP and 3DM: what it does when all is well, and when it is not."""

from __future__ import annotations

import errno
import os
import signal
from pathlib import Path

import pytest

from loftscan.cad_files import CadWriter
from reconstruction.errors import ReconstructionError


def test_without_cad_formats_no_child_is_started(tmp_path: Path) -> None:
    with CadWriter(("stl", "ply")) as cad:
        assert cad._child is None
        cad.write(tmp_path, name="part")
        cad.finish()


def test_a_child_with_nothing_to_write_ends_with_its_block() -> None:
    with CadWriter(("step",)) as cad:
        child = cad._child
        assert child is not None
        assert child.poll() is None
    assert child.returncode is not None


def test_a_killed_child_is_a_message_with_a_remedy(tmp_path: Path) -> None:
    with CadWriter(("step",)) as cad:
        assert cad._child is not None
        os.kill(cad._child.pid, signal.SIGSEGV)
        cad._child.wait()
        cad.write(tmp_path, name="part")
        with pytest.raises(ReconstructionError, match=r"died.*--formats"):
            cad.finish()


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    missing = tmp_path / "gone"
    with CadWriter(("step",)) as cad:
        cad.write(missing, name="part")
        with pytest.raises(OSError, match="No such file") as failure:
            cad.finish()
    assert failure.value.errno == errno.ENOENT
    assert str(missing) in str(failure.value.filename)


def test_a_damaged_surface_file_is_a_one_line_message(tmp_path: Path) -> None:
    (tmp_path / "surface.json").write_text("{}", encoding="utf-8")
    with CadWriter(("step",)) as cad:
        cad.write(tmp_path, name="part")
        with pytest.raises(ReconstructionError, match=r"surface\.json") as failure:
            cad.finish()
    assert "\n" not in str(failure.value)
