"""Asks a scan under way for the slice that is worth most: reads its folder, writes NAME.next.json.

    slices/*.npz --> contours --> `reconstruction.adaptive` --> NAME.next.json --> the scan

Each slice is drawn once and only its contours are kept. An answer is written whenever all slices
that are in the folder have been seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from acquisition.scanfile import POLL_S, ScanFolder
from acquisition.slice_request import SliceRequest, write_request
from loftscan.gathering import find_strays
from loftscan.scans import Absent, Piece
from reconstruction.adaptive import Kind, Level, choose, expected_mm, level_of, spans_between
from reconstruction.fitting.curve import Exact
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.slices import Frame, Slice


def advise(
    folder: ScanFolder,
    read: Callable[[int], Piece],
    ended: Callable[[], bool],
    pause: Callable[[float], None],
) -> None:
    """Answer an adaptive scan until it has ended.

    Raises
    ------
    StorageFailed
        The answer cannot be written; the scan goes on by itself.
    """
    adviser = Adviser(folder, read)
    while True:
        over = ended()  # before the look at what is there
        if not adviser.look():
            if over:
                return
            pause(POLL_S)


class Adviser:
    """What is known of the slices so far."""

    def __init__(self, folder: ScanFolder, read: Callable[[int], Piece]) -> None:
        self._folder = folder
        self._read = read
        self._plan = folder.record().plan
        self._levels: dict[int, Level] = {}
        self._plane: Frame | None = None

    def look(self) -> bool:
        """Take in one slice that is new, and answer when it was the last; False for none."""
        there = self._folder.indices()
        new = [index for index in there if index not in self._levels]
        if not new:
            return False
        self._levels[new[0]] = self._level(new[0])
        if len(new) == 1 and set(there) >= set(self._plan.first_indices):
            assert self._plan.adaptive is not None  # nobody else is advised
            asked = answer(self._levels, there, self._plan.adaptive.tolerance_mm)
            write_request(self._folder.path, asked)
        return True

    def _level(self, index: int) -> Level:
        assert self._plan.ring is not None  # an adaptive plan has rings
        height_mm = index * self._plan.ring.step_mm
        arrival = self._read(index)
        if isinstance(arrival, Absent):
            return Level(height_mm, Kind.UNREAD)
        piece = _without_strays(arrival.piece)
        self._plane = self._plane or piece.frame
        return level_of(draw_outlines(piece, exact=Exact.NEVER), self._plane, height_mm)


def answer(
    levels: Mapping[int, Level], there: tuple[int, ...], tolerance_mm: float
) -> SliceRequest:
    """What is asked for after the slices that are there."""
    read = [index for index in there if levels[index].kind is not Kind.UNREAD]
    if all(levels[index].kind is Kind.NOTHING for index in read):
        return SliceRequest(there, None, "no slice shows anything of a part", None)
    spans = spans_between([levels[index] for index in read])
    choice, whole_mm = choose(spans, read, tolerance_mm, there), expected_mm(spans)
    if choice is not None:
        return SliceRequest(there, choice.position, choice.span.why, choice.span.expected_mm)
    if whole_mm <= tolerance_mm:
        why = f"98 % of the surface is expected within {whole_mm:.3g} mm"
    else:
        why = f"no place is left where it would help; 98 % are expected within {whole_mm:.3g} mm"
    return SliceRequest(there, None, why, whole_mm)


def _without_strays(piece: Slice) -> Slice:
    strays = find_strays(piece)
    if not strays.any():
        return piece
    return replace(piece, points_mm=piece.points_mm[~strays], corners_mm=None)
