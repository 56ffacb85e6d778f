"""What the surface of `--method fit` does not show by itself, in sentences."""

from __future__ import annotations

from collections import Counter

from loftscan.spans import spans
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.skinning.branch import Branch, Ending
from reconstruction.skinning.ends import Apex, Brim
from reconstruction.skinning.exact_skins import AnySkin
from reconstruction.skinning.layout import Layout

_MOST = 8  # doubts that are said one by one


def judge_branches(done: FittedReconstruction) -> list[str | None]:
    """Say what is doubtful about contours, branches, and how the part ends."""
    return [
        done.skinned.wrapping or None,
        *_shortened(tell_doubts(done)),
        _borders(done),
        _runs(done),
        _shoulders(done),
        _ends(done),
    ]


def tell_doubts(done: FittedReconstruction) -> list[str]:
    """Say everything that is doubtful about contours and how they follow each other."""
    ringed = done.skinned.layout is Layout.RINGS  # of others it is known that they are open
    notes = [
        f"slice {section.index}: {note}"
        for section in done.sections
        for note in (*section.outlines.notes, *(section.outlines.undecided if ringed else ()))
    ]
    return [*done.skinned.branching.warnings, *notes]


def _shortened(said: list[str]) -> list[str | None]:
    if len(said) <= _MOST:
        return list(said)
    rest = len(said) - _MOST
    return [*said[:_MOST], f"and {rest} more doubts: all are in the report"]


def _borders(done: FittedReconstruction) -> str | None:
    """What encloses nothing is no solid."""
    if not done.skinned.open:
        return None
    seen = "side by side" if done.skinned.layout is Layout.STRIPES else "about a part of a turn"
    return (
        f"the sections are open and lie {seen}, so the surface is open, with borders: no volume,"
        " and CAD files hold a sheet, no solid (rings are asked for by --layout rings)"
    )


def _runs(done: FittedReconstruction) -> str | None:
    """Open contours are no part of a solid."""
    named = [section for section in done.sections if section.outlines.runs]
    if not named or done.skinned.layout is not Layout.RINGS:
        return None
    many = sum(len(section.outlines.runs) for section in named)
    return (
        f"slices {spans(each.index for each in named)}: {many} open contours; their points hold "
        "the surface where it passes by, and are no wall of their own"
    )


def _shoulders(done: FittedReconstruction) -> str | None:
    """A step between two slices is made level; no slice tells at which height it is."""
    branches = done.skinned.branching.branches
    shoulders = [each for each in done.skinned.branching.joints if each.shoulder]
    if not shoulders or not done.skinned.shown:
        return None
    between = [
        "{} and {}".format(*(_nearest(branches[each], joint.height_mm) for each in (one, other)))
        for joint in shoulders
        for one, other in [(*joint.below, *joint.above)]
    ]
    return (
        f"contours step abruptly between slices {', '.join(between)}: made level, midway; do not"
        " measure at which height"
    )


def _nearest(branch: Branch, height_mm: float) -> int:
    """The slice of a branch nearest to a height."""
    nearest = min(branch.outlines, key=lambda each: abs(each.height_mm - height_mm))
    return nearest.slice_index


def _ends(done: FittedReconstruction) -> str | None:
    """Ends that no slice has seen are closed, and stand on nothing."""
    counts = Counter(kind for skin in done.skinned.shown for kind in _kinds(skin))
    if not done.skinned.shown:
        counts["closed by a flat cap"] = len(done.cap_heights_mm)
    if not counts.total():
        return None
    words = [f"{many} {kind}" for kind, many in sorted(counts.items())]
    return f"ends of the part that no slice samples: {', '.join(words)}; do not measure on them"


def _kinds(skin: AnySkin) -> list[str]:
    """How the open ends of a branch were closed; joints are none, nor what a shape tells."""
    if skin.brims is None or skin.branch.ends is None or skin.open:
        return []
    pairs = zip(skin.brims, skin.branch.ends, strict=True)
    return [
        _kind(brim)
        for (brim, end), seen in zip(pairs, skin.seen, strict=True)
        if not (seen and isinstance(brim, Apex))
        and end.ending is not Ending.JOINED
        and not (skin.shape and isinstance(brim, Apex))
    ]


def _kind(brim: Brim | Apex) -> str:
    if isinstance(brim, Brim):
        return "closed by a flat cap"
    return "run out in a tip" if brim.sharp else "rounded off"
