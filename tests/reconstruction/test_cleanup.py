"""Cleanup: what it repairs, what it promises, and what a child can do to break a promise."""

import os
import signal
import sys
import textwrap

import numpy as np
import pytest
import trimesh

from reconstruction.cleanup import CHILD, CleanupSettings, clean
from reconstruction.errors import CleanupFailed, MissingExtra
from reconstruction.meshing import Mesh

RADIUS_MM = 30.0


def ball(subdivisions: int = 3) -> Mesh:
    solid = trimesh.creation.icosphere(subdivisions, RADIUS_MM)
    # The upper third is marked, as an end cap would be.
    return Mesh(solid.vertices, solid.faces, solid.vertices[:, 2] > RADIUS_MM / 3)


def with_faces(mesh: Mesh, faces) -> Mesh:
    return Mesh(mesh.vertices_mm, faces, mesh.synthetic)


def child_that(tmp_path, code: str) -> tuple[str, ...]:
    """A child of our own; `save` leaves a result as the real one does."""
    script = tmp_path / "child.py"
    preamble = """
        import json, os, signal, sys, time
        import numpy as np
        def save(vertices, faces):
            np.savez("result.npz", vertices_mm=vertices, faces=faces)
            with open("report.json", "w") as file:
                json.dump({"passes": 1, "peak_memory_mb": 1.0}, file)
        given = np.load("request.npz")
        vertices, faces = given["vertices_mm"], given["faces"]
    """
    script.write_text(textwrap.dedent(preamble) + textwrap.dedent(code))
    return (sys.executable, str(script))


def test_a_sound_mesh_comes_back_as_it_is() -> None:
    mesh = ball()
    cleaned = clean(mesh)
    assert cleaned.mesh is mesh
    assert cleaned.peak_memory_mb is None
    assert cleaned.before is cleaned.after


def test_holes_are_closed_and_marks_survive() -> None:
    mesh = ball()
    cleaned = clean(with_faces(mesh, np.delete(mesh.faces, [0, 1, 2, 400, 900], axis=0)))
    assert cleaned.before.boundary_edges > 0
    assert cleaned.after.sound
    assert cleaned.work.holes_closed >= 3
    assert cleaned.after.volume_mm3 == pytest.approx(4 / 3 * np.pi * RADIUS_MM**3, rel=0.03)
    order = np.lexsort(cleaned.mesh.vertices_mm.T)
    expected = np.lexsort(mesh.vertices_mm.T)
    np.testing.assert_array_equal(
        cleaned.mesh.vertices_mm[order], mesh.vertices_mm[expected], strict=True
    )
    np.testing.assert_array_equal(cleaned.mesh.synthetic[order], mesh.synthetic[expected])
    assert cleaned.peak_memory_mb is not None
    assert 20 < cleaned.peak_memory_mb < 1000


def test_a_soup_that_is_turned_doubled_and_finned_becomes_one_sound_ball() -> None:
    mesh = ball()
    faces = mesh.faces.copy()
    faces[::5] = faces[::5, ::-1]
    corners = mesh.vertices_mm[np.vstack([faces, faces[:7]])].reshape(-1, 3)
    fin = [corners[0], corners[1], 1.5 * corners[0]]
    vertices = np.vstack([corners, fin])
    marks = np.concatenate([mesh.synthetic[np.vstack([faces, faces[:7]])].ravel(), [False] * 3])
    soup = Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3), marks)
    cleaned = clean(soup)
    assert cleaned.after.sound
    assert cleaned.work.merged_vertices > 1500
    assert cleaned.work.duplicate_faces >= 7
    assert cleaned.work.nonmanifold_faces >= 1
    assert cleaned.work.reoriented_faces > 200
    # The fin's edge can stay as a bump of a face or two; the ball is the ball.
    assert cleaned.after.volume_mm3 == pytest.approx(4 / 3 * np.pi * RADIUS_MM**3, rel=0.03)


def test_an_inside_out_ball_is_turned() -> None:
    mesh = ball(2)
    cleaned = clean(with_faces(mesh, mesh.faces[:, ::-1]))
    assert cleaned.after.sound
    assert cleaned.work.reoriented_faces == len(mesh.faces)


def test_a_flat_face_is_flipped_away_without_opening_the_mesh() -> None:
    cube = trimesh.creation.box((10, 10, 10))
    a, b, c = cube.faces[0]
    vertices = np.vstack([cube.vertices, (cube.vertices[a] + cube.vertices[b]) / 2])
    faces = np.vstack([cube.faces[1:], [[a, 8, c], [8, b, c], [a, b, 8]]])
    cleaned = clean(Mesh(vertices, faces, np.zeros(9, bool)))
    assert (cleaned.before.degenerate_faces, cleaned.after.degenerate_faces) == (1, 0)
    assert cleaned.after.sound
    assert cleaned.after.volume_mm3 == pytest.approx(1000.0, rel=1e-9)


def test_a_hole_larger_than_allowed_stays_open() -> None:
    mesh = ball(2)
    above = mesh.vertices_mm[mesh.faces][:, :, 2].min(axis=1) > 0
    cleaned = clean(with_faces(mesh, mesh.faces[~above]), CleanupSettings(max_hole_edges=5))
    assert cleaned.after.boundary_edges == cleaned.before.boundary_edges > 5
    assert cleaned.after.manifold


def test_decimation_and_remeshing_keep_the_solid_and_its_marks() -> None:
    mesh = ball(4)
    thinned = clean(mesh, CleanupSettings(decimate_to_faces=1200))
    assert thinned.after.sound
    assert thinned.after.faces <= 1200
    assert thinned.work.decimated_faces == len(mesh.faces) - thinned.after.faces
    remeshed = clean(mesh, CleanupSettings(remesh_edge_mm=3.0))
    assert remeshed.after.sound
    assert remeshed.work.remeshed == 1
    for done in (thinned.mesh, remeshed.mesh):
        high = done.vertices_mm[:, 2] - RADIUS_MM / 3
        assert np.all(done.synthetic[high > 4.0])
        assert not np.any(done.synthetic[high < -4.0])


def test_a_remesh_too_coarse_for_the_volume_is_refused() -> None:
    with pytest.raises(CleanupFailed, match=r"volume changed by .* 1 % is allowed"):
        clean(ball(3), CleanupSettings(remesh_edge_mm=25.0))


def test_what_cannot_be_oriented_is_refused() -> None:
    turns, width = np.linspace(0, 2 * np.pi, 40, endpoint=False), np.array([-3.0, 3.0])
    radius = 20 + width * np.cos(turns / 2)[:, None]
    strip = np.stack(
        [
            radius * np.cos(turns)[:, None],
            radius * np.sin(turns)[:, None],
            width * np.sin(turns / 2)[:, None],
        ],
        axis=-1,
    ).reshape(-1, 3)
    rows = np.arange(40)
    low, high = 2 * rows, 2 * rows + 1
    low_next, high_next = np.roll(low, -1), np.roll(high, -1)
    low_next[-1], high_next[-1] = 1, 0  # the half twist of Moebius
    faces = np.vstack(
        [np.stack([low, low_next, high], 1), np.stack([high, low_next, high_next], 1)]
    )
    with pytest.raises(CleanupFailed, match="mesh cleanup"):
        clean(Mesh(strip, faces, np.zeros(80, bool)), CleanupSettings(max_hole_edges=0))


def broken_ball() -> Mesh:
    mesh = ball(2)
    return with_faces(mesh, np.vstack([mesh.faces, mesh.faces[:1]]))


def test_a_crash_of_the_child_is_a_message_with_the_signal(tmp_path) -> None:
    child = child_that(tmp_path, "os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(CleanupFailed, match="SIGSEGV"):
        clean(broken_ball(), child=child)


def test_a_killed_child_hints_at_memory(tmp_path) -> None:
    child = child_that(tmp_path, "os.kill(os.getpid(), signal.SIGKILL)")
    with pytest.raises(CleanupFailed, match="SIGKILL, perhaps for want of memory"):
        clean(broken_ball(), child=child)


def test_a_child_that_never_ends_is_stopped_at_the_time_limit(tmp_path) -> None:
    note = tmp_path / "pid"
    code = f"open({str(note)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    child = child_that(tmp_path, code)
    with pytest.raises(CleanupFailed, match=r"not done in 1\.5 s"):
        clean(broken_ball(), CleanupSettings(time_limit_s=1.5), child=child)
    with pytest.raises(ProcessLookupError):
        os.kill(int(note.read_text()), 0)


@pytest.mark.parametrize("limit_mb", [100, 250])
def test_too_little_memory_is_named(limit_mb) -> None:
    with pytest.raises(CleanupFailed, match=f"limit of {limit_mb} MB"):
        clean(broken_ball(), CleanupSettings(memory_limit_mb=limit_mb))


def test_the_smallest_workable_memory_does() -> None:
    assert clean(broken_ball(), CleanupSettings(memory_limit_mb=400)).after.sound


def test_memory_that_runs_out_inside_pymeshlab_is_named() -> None:
    settings = CleanupSettings(memory_limit_mb=400, remesh_edge_mm=0.1)
    with pytest.raises(CleanupFailed, match="limit of 400 MB"):
        clean(ball(2), settings)


LIES = {
    "quits": ("sys.exit(7)", "ended with 7"),
    "leaves nothing": ("pass", "no readable result"),
    "torn": ("open('report.json', 'w').write('{}'); open('result.npz', 'w')", "no readable"),
    "doubled": ("save(vertices, np.vstack([faces, faces[:1]]))", "not manifold"),
    "opened": ("save(vertices, faces[1:])", "was closed, now 3 edges are open"),
    "emptied": ("save(vertices, faces[:0])", "no face is left"),
    "moved": ("save(vertices * 1.001, faces)", "mm from all of the mesh's own"),
    "inward": ("save(vertices, faces[:, ::-1])", "look inward"),
    "turned": ("faces[0] = faces[0, ::-1]; save(vertices, faces)", "opposite ways"),
    "astray": ("save(vertices, faces + 1)", "outside 0"),
    "nan": ("save(vertices * np.nan, faces)", "no finite"),
    "planar": ("save(vertices[:, :2], faces)", "no finite"),
}


@pytest.mark.parametrize(("lie", "found"), LIES.values(), ids=LIES)
def test_a_lying_child_is_found_out(lie, found, tmp_path) -> None:
    asked = CleanupSettings(merge_within_mm=1e-9)  # so that the child runs at all
    with pytest.raises(CleanupFailed, match=found):
        clean(ball(2), asked, child=child_that(tmp_path, lie))


def test_a_volume_off_by_more_than_a_percent_is_found_out(tmp_path) -> None:
    settings = CleanupSettings(remesh_edge_mm=5.0)
    child = child_that(tmp_path, "save(vertices * 1.004, faces)")
    with pytest.raises(CleanupFailed, match=r"volume changed by \+1\.20 %"):
        clean(ball(2), settings, child=child)
    child = child_that(tmp_path, "save(vertices * 1.003, faces)")
    assert clean(ball(2), settings, child=child).after.sound


def fake_pymeshlab(tmp_path, monkeypatch, code: str) -> tuple[str, ...]:
    (tmp_path / "pymeshlab.py").write_text(code)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return CHILD


@pytest.mark.parametrize(
    "code",
    [
        "raise ImportError('libGL.so.1: cannot open shared object file: No such file')",
        "raise ModuleNotFoundError('no pymeshlab')",
        "def filter_list(): return ['meshing_remove_null_faces'] * 235",
    ],
    ids=["no libgl1", "not installed", "no libopengl0"],
)
def test_a_missing_library_is_named_with_the_command(code, tmp_path, monkeypatch) -> None:
    child = fake_pymeshlab(tmp_path, monkeypatch, code)
    with pytest.raises(MissingExtra, match="apt-get install libgl1 libopengl0"):
        clean(broken_ball(), child=child)


def test_a_refusal_of_the_library_is_one_line(tmp_path, monkeypatch) -> None:
    code = """
class PyMeshLabException(Exception): pass
class Mesh:
    def __init__(self, *arrays): pass
class MeshSet:
    def __init__(self, verbose): pass
    def add_mesh(self, mesh): raise PyMeshLabException("no\\n  such thing")
def filter_list(): return ["a"] * 281
"""
    child = fake_pymeshlab(tmp_path, monkeypatch, code)
    with pytest.raises(CleanupFailed, match=r"^mesh cleanup: no such thing; .* left as it was$"):
        clean(broken_ball(), child=child)


def test_repairs_that_never_settle_are_given_up(tmp_path, monkeypatch) -> None:
    code = """
import sys
import numpy as np
class PyMeshLabException(Exception): pass
class Mesh:
    def __init__(self, vertices, faces): self.v, self.f = vertices, faces
    def vertex_number(self): return len(self.v)
    def face_number(self): return len(self.f)
    def vertex_matrix(self): return self.v
    def face_matrix(self): return self.f
class MeshSet:
    def __init__(self, verbose): pass
    def add_mesh(self, mesh): self.mesh = mesh
    def current_mesh(self): return self.mesh
    def meshing_close_holes(self, maxholesize):
        self.mesh.f = self.mesh.f[1:]  # each pass eats a face
        return {"closed_holes": 0, "new_faces": 0}
    def get_topological_measures(self):
        return {"boundary_edges": 3, "non_two_manifold_edges": 0}
    def __getattr__(self, name):
        return lambda **options: None
def filter_list(): return ["a"] * 281
"""
    child = fake_pymeshlab(tmp_path, monkeypatch, code)
    with pytest.raises(CleanupFailed, match="still changing after 10 passes"):
        clean(broken_ball(), child=child)


def test_a_mesh_without_faces_is_refused() -> None:
    with pytest.raises(CleanupFailed, match="no faces"):
        clean(Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros(0, bool)))


@pytest.mark.parametrize(
    "wrong",
    [
        {"merge_within_mm": -1.0},
        {"remesh_edge_mm": 0.0},
        {"decimate_to_faces": 3},
        {"time_limit_s": 0.0},
    ],
)
def test_settings_without_sense_are_the_callers_mistake(wrong) -> None:
    with pytest.raises(ValueError, match="cleanup"):
        CleanupSettings(**wrong)


def test_nothing_is_left_behind(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    clean(broken_ball())
    child = (sys.executable, "-c", f"import os; os.kill(os.getpid(), {int(signal.SIGABRT)})")
    with pytest.raises(CleanupFailed, match="SIGABRT"):
        clean(broken_ball(), child=child)
    assert list(tmp_path.iterdir()) == []
