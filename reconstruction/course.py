"""One reconstruction under way, by whichever method: slices in, sections out, at last a surface.

::

    slice  -->  course.draw    -->  section, or why it has none
                course.finish  -->  the surface of all of them
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from reconstruction.errors import NotLoftable, TooFewPoints
from reconstruction.sections import Skipped
from reconstruction.slices import Slice

S = TypeVar("S", covariant=True)
R = TypeVar("R", covariant=True)


@dataclass(frozen=True, slots=True)
class Remedy:
    """What to do where there are too few sections, as it depends on where slices come from."""

    more_slices: str
    other_settings: str  # where slices gave no section


OF_A_CLOUD = Remedy("choose a smaller --spacing-mm", "Try another --axis or --spacing-mm")


class Course(Protocol[S, R]):
    """What a method does with slices, in the order of their heights."""

    def draw(self, piece: Slice) -> S:
        """Turn the next slice into a section.

        Raises
        ------
        TooFewPoints
            It has none; the message says why.
        """
        ...

    def finish(self, skipped: Sequence[Skipped], remedy: Remedy) -> R:
        """Make the surface of all sections.

        Raises
        ------
        NotLoftable
            There are fewer than two, or none that follow each other.
        CleanupFailed, MissingExtra
            From the mesh cleanup.
        """
        ...


def run_course(
    slices: Iterable[Slice], course: Course[S, R], remedy: Remedy
) -> Iterator[S | Skipped | R]:
    """Take a course over a stream of slices.

    Yields
    ------
    section or Skipped
        One of the two for every slice, as soon as it is known.
    surface
        Once, at the end.

    Raises
    ------
    NotLoftable, CleanupFailed, MissingExtra
        At the end, as `Course.finish`.
    """
    skipped: list[Skipped] = []
    for piece in slices:
        try:
            section = course.draw(piece)
        except TooFewPoints as few:
            skipped.append(Skipped(piece.index, len(piece.points_mm), str(few)))
            yield skipped[-1]
        else:
            yield section
    yield course.finish(skipped, remedy)


def too_few(
    kind: str, indices: Sequence[int], all_indices: Sequence[int], skipped: Sequence[Skipped],
    remedy: Remedy,
) -> NotLoftable:  # fmt: skip
    """Say how many slices gave a section of this kind, why others did not, and what to do.

    Parameters
    ----------
    indices, all_indices
        Of the sections of this kind, and of all.
    """
    count = len(all_indices) + len(skipped)
    found = f"{len(indices)} of {count} slices gave a {kind}, two are needed"
    if not skipped:
        return NotLoftable(f"{found}: {remedy.more_slices}", indices=tuple(all_indices))
    fullest = max(skipped, key=lambda each: each.points)
    why = f"slice {fullest.index}: {fullest.reason}"
    return NotLoftable(f"{found}; {why}. {remedy.other_settings}", indices=tuple(all_indices))
