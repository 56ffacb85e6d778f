"""Whether a calibration may be written, and what is told of it."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.calibration import Calibration, Fit, deciding_keys
from acquisition.calibration_in_force import contradiction
from acquisition.station import Station
from loftscan.calibrating.artefact import Artefact
from loftscan.calibrating.errors import CalibrationRefused
from loftscan.calibrating.joint import Calibrated

_UM = 1e3
_BIAS = 0.2  # of the noise, in the mean of an element
_SIGMAS = 5.0


def must_hold(found: Calibrated, station: Station) -> None:
    """Refuse what must not be written.

    Raises
    ------
    CalibrationRefused
        Axes exchanged, station.toml contradicted, not observable, or the held-out spacing off.
    """
    if found.focus.planes_swapped:
        raise CalibrationRefused(
            "calibration: the sensor's x and z are exchanged: what station.toml's profiler calls x"
            " lies at the standoff; exchange the two in [profiler]"
        )
    if found.focus.axes_swapped:
        raise CalibrationRefused(
            "calibration: the axes are swapped: the part turns when the stage moves, and is lifted"
            " when the table turns; exchange their addresses or cables"
        )
    # In this order: a scale that cannot be told contradicts nothing.
    if not found.verdict.observable:
        raise CalibrationRefused(f"calibration: not observable: {found.verdict.words()}")
    if (against := contradiction(found.kinematics, station)) is not None:
        raise CalibrationRefused(f"calibration: {against}; correct it and calibrate again")
    if (misfit := _misfit(found)) is not None:
        raise CalibrationRefused(f"calibration: {misfit}")
    for each in found.checks:
        if not each.sound:
            off_um = _UM * (each.found_mm - each.certified_mm)
            raise CalibrationRefused(
                f"calibration: the held-out spacing {each.name} comes out {off_um:+.1f} um off,"
                f" and {3 * _UM * each.sd_mm:.1f} um is its bound; see residuals.png, check"
                " artefact.toml and its temperature"
            )


def made(
    found: Calibrated,
    station: Station,
    artefact: Artefact,
    scans: Sequence[str],
    now: datetime,
) -> Calibration:
    """Give what calibration.toml will say."""
    count = len(found.verdict.names)
    return Calibration(
        kinematics=found.kinematics,
        made=now.replace(microsecond=0),
        fit=Fit(
            artefact=artefact.words(),
            artefact_sha256=artefact.sha256,
            certificate=artefact.certificate,
            software=f"loftscan {version('loftscan')}",
            points=found.solution.points,
            stray=found.solution.stray,
            sigma_mm=float(found.solution.model.sigma_mm.max()),
            s0=found.solution.s0,
            alike=found.solution.alike,
            rank=found.verdict.rank,
            condition=found.verdict.condition,
        ),
        names=found.verdict.names,
        covariance=found.solution.covariance[:count, :count],
        station=deciding_keys(station),
        scans=tuple(scans),
        checks=tuple(_checked(found)),
    )


def lines(found: Calibrated) -> list[str]:
    """What a person reads of it; nothing where nothing was solved."""
    if not found.solution.points:
        return []
    solution, verdict = found.solution, found.verdict
    told = [
        f"points: {solution.points} used of {found.points_seen}, {solution.stray} strays;"
        f" noise {_UM * float(solution.model.sigma_mm.max()):.1f} um, s0 {solution.s0:.3f},"
        f" neighbours alike x {solution.alike:.2f}",
        f"rank {verdict.rank} of {len(verdict.names)}, condition {verdict.condition:.3g}",
    ]
    sd = np.sqrt(np.maximum(np.diag(solution.covariance), 0.0))
    for name, value, each in zip(verdict.names, solution.at, sd, strict=False):
        told.append(f"  {name:18s} {value:14.6f} +- {each:.2g}")
    return told + [f"held out: {each}" for each in _checked(found)]


def write_report(
    found: Calibrated, amplitudes: Mapping[str, FloatArray], refused: str | None, folder: Path
) -> None:
    """Write report.html beside the pictures."""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td>"
        + "".join(
            "<td>not told</td>" if np.isnan(each) else f"<td>{_UM * each:.2f}</td>"
            for each in values
        )
        + "</tr>"
        for name, values in amplitudes.items()
    )
    verdict = f"<p><b>Refused:</b> {html.escape(refused)}</p>" if refused else "<p>Written.</p>"
    text = "\n".join(lines(found))
    (folder / "report.html").write_text(
        "<!doctype html><meta charset='utf-8'><title>Calibration</title>"
        f"<h1>Calibration</h1>{verdict}<pre>{html.escape(text)}</pre>"
        "<h2>Residuals against the table's angle</h2><img src='residuals.png'>"
        "<h2>Harmonics, um</h2><img src='harmonics.png'>"
        f"<table border=1><tr><th>element<th>1<th>2<th>3<th>4 a turn</tr>{rows}</table>\n",
        encoding="utf-8",
    )


def _misfit(found: Calibrated) -> str | None:
    """What of the artefact is not as it is certified, in words.

    The noise is told by the residuals, so that a wrong size passes for noise; but it is not zero
    in the mean of an element, and certified sizes that contradict each other do not fit together.
    """
    solution, first = found.solution, 0
    for face in solution.model.faces:
        own = solution.residuals[first : first + len(face.rows)]
        first += len(face.rows)
        mean = float(own.mean())
        if abs(mean) > max(_BIAS, _SIGMAS * (solution.alike / len(own)) ** 0.5):
            off_um = mean * _UM * float(solution.model.sigma_mm[face.scan])
            return (
                f"{face.name} lies {off_um:+.1f} um off in the mean of its points; correct its size"
                " in artefact.toml, or see what else stands there"
            )
    told = solution.model.told()
    for name, off in zip(told, solution.residuals[-len(told) :] if told else (), strict=True):
        if abs(off) > _SIGMAS:
            return (
                f"the certified {name} is {abs(off):.0f} of its standard uncertainties off: sizes"
                " in artefact.toml contradict each other; correct them, or their sd"
            )
    return None


def _checked(found: Calibrated) -> list[str]:
    return [
        f"{each.name}, scan {each.scan + 1}: {each.found_mm:.4f} mm, certified"
        f" {each.certified_mm:.4f}, off {_UM * (each.found_mm - each.certified_mm):+.1f} um"
        f" (bound {3 * _UM * each.sd_mm:.1f})"
        for each in found.checks
    ]
