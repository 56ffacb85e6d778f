"""Does the station still stand as it was calibrated: a short re-scan held to what was solved.

Nothing of the kinematics is solved again: a few rings would tell it badly. The artefact alone is
fitted, and what then does not fit is drift: noise above that of the calibration, and spacings that
are no longer certified ones. Each check is a line of calibration-trend.jsonl, and a point of its
plot.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from acquisition.calibration import Calibration
from loftscan.calibrating.artefact import Artefact
from loftscan.calibrating.joint import Check, held_to
from loftscan.calibrating.model import Seen

_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class Drift:
    """What one check found."""

    at: str  # ISO 8601
    calibration_sha256: str
    points: int
    sigma_mm: float
    excess_mm: float  # of the noise over that of the calibration, root of the squares' difference
    spacings_mm: tuple[tuple[str, float, float], ...]  # name, difference, its sd

    def beyond(self, limit_mm: float) -> str | None:
        """What is off by more than a limit, in words; None for nothing."""
        if self.excess_mm > limit_mm:
            return f"the artefact fits {1e3 * self.excess_mm:.1f} um worse than when calibrated"
        for name, off_mm, sd_mm in self.spacings_mm:
            if abs(off_mm) > max(limit_mm, _SIGMAS * sd_mm):
                return f"the spacing {name} is off by {1e3 * off_mm:+.1f} um"
        return None


def drift(seen: Seen, calibration: Calibration, artefact: Artefact, now: datetime) -> Drift:
    """Hold a re-scan to a calibration; raises CalibrationRefused where nothing is found."""
    solution, held_out = held_to(seen, calibration.kinematics, artefact)
    sigma_mm = float(solution.model.sigma_mm.max())
    excess = math.sqrt(max(sigma_mm**2 - calibration.fit.sigma_mm**2, 0.0))
    return Drift(
        at=now.isoformat(timespec="seconds"),
        calibration_sha256=calibration.sha256,
        points=solution.points,
        sigma_mm=sigma_mm,
        excess_mm=excess,
        spacings_mm=tuple(_told(each) for each in held_out),
    )


def _told(check: Check) -> tuple[str, float, float]:
    return check.name, check.found_mm - check.certified_mm, check.sd_mm


def remember(found: Drift, file: Path) -> list[Drift]:
    """Add a check to the trend; give back all of it, oldest first. Lines that are none are left."""
    line = json.dumps(
        {name: getattr(found, name) for name in Drift.__dataclass_fields__}, ensure_ascii=False
    )
    with file.open("a", encoding="utf-8") as trend:
        trend.write(line + "\n")
    known = [_read(each) for each in file.read_text(encoding="utf-8").splitlines()]
    return [each for each in known if each is not None]


def draw_trend(trend: Sequence[Drift], limit_mm: float, path: Path) -> None:
    """Draw excess noise and spacings against time, with the limit."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axis = figure.subplots()
    times = [datetime.fromisoformat(each.at) for each in trend]
    axis.plot(times, [1e3 * each.excess_mm for each in trend], "o-", label="excess noise")  # type: ignore[arg-type] # dates
    for name in dict.fromkeys(n for each in trend for n, *_ in each.spacings_mm):
        rows = [(t, v) for t, each in zip(times, trend, strict=True)
                for n, v, _ in each.spacings_mm if n == name]  # fmt: skip
        axis.plot([t for t, _ in rows], [1e3 * v for _, v in rows], "s-", label=f"spacing {name}")  # type: ignore[arg-type] # dates
    for bound in (-limit_mm, limit_mm):
        axis.axhline(1e3 * bound, color="C3", ls="--", lw=1)
    axis.set_ylabel("um")
    axis.set_title("Drift since calibration; dashed: drift_limit_mm", fontsize=9)
    axis.legend(fontsize=7)
    axis.grid(alpha=0.3)
    figure.autofmt_xdate()
    figure.savefig(path, dpi=110)


def _read(line: str) -> Drift | None:
    try:
        table = json.loads(line)
        spacings = tuple((str(n), float(v), float(s)) for n, v, s in table.pop("spacings_mm"))
        found = Drift(**table, spacings_mm=spacings)
        datetime.fromisoformat(found.at)
    except (ValueError, TypeError, KeyError, AttributeError):
        return None
    return found if np.isfinite([found.sigma_mm, found.excess_mm]).all() else None
