"""A file is whole or not there, whatever interrupts its writer."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from reconstruction.exporting import (
    write_glb,
    write_iges,
    write_ply,
    write_sections_json,
    write_step,
    write_stl,
    write_surface_json,
    write_threedm,
)
from reconstruction.exporting.atomic import replacing
from reconstruction.meshing import Mesh
from reconstruction.nurbs.values import Surface

FACES = 2000
SOUP = Mesh(
    np.random.default_rng(0).normal(size=(1000, 3)),
    np.random.default_rng(1).integers(0, 1000, (FACES, 3)),
    np.zeros(1000),
)
SQUARE = Surface(
    degree_u=1,
    degree_v=1,
    knots_u=np.array([0.0, 0, 1, 1]),
    knots_v=np.array([0.0, 0, 1, 1]),
    control_points_mm=np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 1]]]),
    weights=np.ones((2, 2)),
    periodic_u=False,
    periodic_v=False,
)
WRITERS = {
    "a.stl": lambda path: write_stl(path, SOUP, name="a"),
    "a.ply": lambda path: write_ply(path, SOUP, name="a", provenance={}),
    "a.glb": lambda path: write_glb(path, SOUP, name="a", provenance={}),
    "surface.json": lambda path: write_surface_json(path, [SQUARE], name="a", provenance={}),
    "sections.json": lambda path: write_sections_json(path, [], name="a", provenance={}),
    "a.step": lambda path: write_step(path, [SQUARE], name="a", provenance={}),
    "a.igs": lambda path: write_iges(path, [SQUARE], name="a", provenance={}),
    "a.3dm": lambda path: write_threedm(path, [SQUARE], name="a", provenance={}),
}
every_writer = pytest.mark.parametrize("name", WRITERS)


def write(path: Path) -> None:
    if path.suffix in (".step", ".igs"):
        pytest.importorskip("OCP.Geom", reason="the extra 'cad' is not installed")
    if path.suffix == ".3dm":
        pytest.importorskip("rhino3dm", reason="the extra 'cad' is not installed")
    WRITERS[path.name](path)


@every_writer
def test_a_file_appears_alone_readable_by_others_and_replaces_the_old_one(name, tmp_path) -> None:
    (tmp_path / name).write_text("old")
    previous = os.umask(0o022)
    try:
        write(tmp_path / name)
    finally:
        os.umask(previous)
    assert list(tmp_path.iterdir()) == [tmp_path / name]
    assert (tmp_path / name).read_bytes() != b"old"
    assert stat.S_IMODE((tmp_path / name).stat().st_mode) == 0o644


@every_writer
def test_a_full_disk_leaves_the_old_file_and_nothing_else(name, tmp_path, monkeypatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / name).write_text("old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as failure:
        write(tmp_path / name)
    assert failure.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == [tmp_path / name]
    assert (tmp_path / name).read_text() == "old"


@every_writer
def test_a_disk_that_fills_while_writing_leaves_nothing(name, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="file size limits are POSIX")
    write(tmp_path / name)  # imports, and the size it would have
    size = (tmp_path / name).stat().st_size
    (tmp_path / name).unlink()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The system itself refuses the second half, as it would on a full disk.
    resource.setrlimit(resource.RLIMIT_FSIZE, (size // 2, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            WRITERS[name](tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_in_the_middle_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with replacing(tmp_path / "a.stl") as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_the_systems_own_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_stl(tmp_path / "missing" / "a.stl", SOUP, name="a")
