"""What a result does not show by itself, in sentences: what was left out, bridged or closed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from drivers.profiler import Reason
from loftscan.branch_findings import judge_branches
from loftscan.gathering import Gathered
from loftscan.methods import AnyReconstruction, AnySection
from loftscan.metrics import is_one_turn
from loftscan.scans import Absent
from loftscan.sliced import Sliced
from loftscan.spans import spans
from reconstruction.pipeline import Reconstruction
from reconstruction.sections import Section, Skipped
from reconstruction.setting_aside import Aside
from reconstruction.skinning.layout import Layout

_NOTABLE_SHARE = 0.02  # of a slice's points left out before the slice is named
_NOTABLE_STRAYS = 0.005  # of all points
_NOTABLE_LOST = 0.005  # of all places
_WIDE_GAP_SHARE = 0.25  # of a section's length


def judge(cutting: Sliced, done: AnyReconstruction) -> tuple[str, ...]:
    """Say what a person should know before using the surface; empty when there is nothing."""
    own = _of_paper(done) if isinstance(done, Reconstruction) else judge_branches(done)
    found = [
        _set_aside(cutting),
        _strays(cutting),
        _wide_gaps(done.sections),
        *own,
        _skipped(done),
        None if _is_laid_open(done) else _lying(cutting, done.sections),
    ]
    return tuple(sentence for sentence in found if sentence)


def _is_laid_open(done: AnyReconstruction) -> bool:
    """Whether open sections are what the surface was made of."""
    return not isinstance(done, Reconstruction) and done.skinned.layout is not Layout.RINGS


def _of_paper(done: Reconstruction) -> list[str | None]:
    return [_left_out(done.sections), _crossing(done.sections), _patchless(done)]


def judge_arrivals(gathered: Gathered, name: str) -> tuple[str, ...]:
    """Say what did not come from a scan called `name`; empty when there is nothing."""
    found = [_missing(gathered), _damaged(gathered, name), _lost(gathered)]
    return tuple(sentence for sentence in found if sentence)


def _missing(gathered: Gathered) -> str | None:
    missing = [each for each in gathered.absent if each.damage is None]
    if not missing:
        return None
    return f"{_numbered('slice', missing)} of the plan: not there, so bridged or cut off"


def _damaged(gathered: Gathered, name: str) -> str | None:
    damaged = [each for each in gathered.absent if each.damage is not None]
    if not damaged:
        return None
    return (
        f"{_numbered('slice', damaged)} damaged, so left out ({damaged[0].damage}): `loftscan scan "
        f"STATION.toml PLAN.toml --out {name} --resume` takes what is damaged again"
    )


def _lost(gathered: Gathered) -> str | None:
    lost, places = int(gathered.reasons[Reason.LOST]), int(gathered.reasons.sum())
    if lost <= _NOTABLE_LOST * places:
        return None
    return (
        f"{lost} of {places} places ({lost / places:.1%}) of the profiles were lost between sensor "
        "and computer: look at the network, or scan more slowly"
    )


def _set_aside(cutting: Sliced) -> str | None:
    plate = cutting.aside.get(Aside.PLATE, 0)
    if not plate:
        return None
    return f"{plate} points of the table plate under the part were set aside"


def _strays(cutting: Sliced) -> str | None:
    aside = cutting.aside
    strays = aside.get(Aside.STRAY, 0)
    points = int(cutting.counts.sum()) + strays + aside.get(Aside.PLATE, 0)
    if strays <= _NOTABLE_STRAYS * points:
        return None
    heights = cutting.aside_mm[Aside.STRAY][:, cutting.axis.column]
    return (
        f"{strays} points ({strays / points:.1%}) between {heights.min():.4g} and "
        f"{heights.max():.4g} mm look stray and were set aside: small clusters apart from the "
        "part; if they belong to it, scan more densely there"
    )


def _left_out(sections: Iterable[Section]) -> str | None:
    named = [s for s in sections if s.left_out > _NOTABLE_SHARE * s.points]
    if not named:
        return None
    points = sum(section.left_out for section in named)
    return (
        f"{points} points in {_numbered('slice', named)} belong to something beside the section's "
        "contour and are left out: the paper's method draws one contour a slice, so a second one "
        "(a handle, a wing, the inside of a rim) is drawn in the report but not made"
    )


def _wide_gaps(sections: Iterable[AnySection]) -> str | None:
    named = [s for s in sections if s.gap_mm > _WIDE_GAP_SHARE * s.length_mm]
    if not named:
        return None
    return (
        f"{_numbered('section', named)}: synthetic over more than a quarter of the length, where "
        "gaps were bridged or an open run was closed; do not measure there"
    )


def _crossing(sections: Iterable[Section]) -> str | None:
    named = [s for s in sections if not is_one_turn(s.contour.rotations)]
    if not named:
        return None
    return (
        f"{_numbered('section', named)}: the contour crosses itself: the macro-region walk "
        "went astray, as it does where two contours come near; try a larger --resolution-mm, "
        "or --crop"
    )


def _skipped(done: AnyReconstruction) -> str | None:
    skipped = _within_the_part(done)
    if not skipped:
        return None
    fullest = max(skipped, key=lambda each: each.points)
    return (
        f"{_numbered('slice', skipped)}: no section, so bridged or cut off "
        f"(slice {fullest.index}: {fullest.reason})"
    )


def _within_the_part(done: AnyReconstruction) -> list[Skipped]:
    """Skipped slices but for empty ends: a scan may begin below a part and end above it."""
    seen = [each.index for each in done.sections]
    seen += [each.index for each in done.skipped if each.points]
    low, high = min(seen, default=0), max(seen, default=0)
    return [each for each in done.skipped if each.points or low < each.index < high]


def _patchless(done: Reconstruction) -> str | None:
    if done.patches:
        return None
    return (
        "no two neighbouring sections have equal counts, so there is no NURBS patch and no STEP "
        "file; the mesh is whole"
    )


def _lying(cutting: Sliced, sections: Iterable[AnySection]) -> str | None:
    """Most sections open: the part was probably not turned about this axis."""
    flags = [not section.closed for section in sections]
    if not flags or np.mean(flags) < 0.5:
        return None
    if isinstance(cutting, Gathered):
        return (
            "most sections are open: does the sensor see the part all round, and do table_sense, "
            "sensor_x and standoff_mm of the station say how it stands?"
        )
    axis = cutting.axis.value
    return f"most sections are open: was the part turned about another axis than --axis {axis}?"


def _numbered(
    noun: str, things: Sequence[AnySection] | Sequence[Skipped] | Sequence[Absent]
) -> str:
    plural = "s" if len(things) > 1 else ""
    return f"{noun}{plural} {spans(each.index for each in things)}"
