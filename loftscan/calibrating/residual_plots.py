"""Residuals against the table's angle, and their harmonics: what the model does not hold.

A residual that comes once a turn is eccentricity that the axis does not explain (a wobbling
bearing, an encoder beside its middle); twice a turn, a wobbling axis or an oval bearing; at the
multiples of the motor's teeth, its steps. Each element is fitted by

    r(t) = a0 + sum a_k cos k t + b_k sin k t,   k = 1 ... 4
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from acquisition.arrays import FloatArray
from loftscan.calibrating.model import Model, placed_with
from loftscan.calibrating.shapes import distances
from loftscan.calibrating.solving import Solution

_HARMONICS = 4
_LARGEST_GAP_RAD = math.radians(60.0)  # two thirds of the shortest wave that is told
_FEWEST = 10  # points of a mean that is drawn
_BROKEN_RAD = math.radians(45.0)  # farther apart, means are not joined
_UM = 1e3
_DRAWN = 4000  # points of an element


def harmonics(angle_rad: FloatArray, residual_mm: FloatArray) -> FloatArray:
    """Amplitudes (k,) in mm of the first harmonics of residuals at table angles (n,).

    NaN where a gap of the turn, such as behind a plate, would let waves grow in it.
    """
    turn = np.sort(np.unique(np.round(angle_rad % math.tau, 6)))
    gaps = np.diff(np.append(turn, turn[0] + math.tau)) if len(turn) else np.array([math.tau])
    if gaps.max() > _LARGEST_GAP_RAD:
        return np.full(_HARMONICS, np.nan)
    orders = np.arange(1, _HARMONICS + 1)
    waves = np.outer(angle_rad, orders)
    rows = np.column_stack([np.ones(len(angle_rad)), np.cos(waves), np.sin(waves)])
    found = np.linalg.lstsq(rows, residual_mm, rcond=None)[0]
    return np.asarray(np.hypot(found[1 : _HARMONICS + 1], found[_HARMONICS + 1 :]))


def residuals_mm(solution: Solution) -> Mapping[str, tuple[FloatArray, FloatArray]]:
    """True turn in rad and distance in mm of each element's points."""
    model: Model = solution.model
    kinematics = solution.kinematics
    placed = placed_with(kinematics, model.seen).part_mm
    found = {}
    for face, own in zip(model.faces, model.own(solution.at), strict=True):
        gap = distances(face.shape, own, placed[face.rows])[0]
        turn = kinematics.table_deg_per_deg * model.seen.table_rad[face.rows]
        found[f"{face.name}, scan {face.scan + 1}"] = (turn, gap)
    return found


def draw(solution: Solution, folder: Path) -> Mapping[str, FloatArray]:
    """Write residuals.png and harmonics.png; give back the amplitudes in mm."""
    from matplotlib.figure import Figure

    told = residuals_mm(solution)
    amplitudes = {name: harmonics(*each) for name, each in told.items()}
    figure = Figure(figsize=(9.0, 1.2 + 1.6 * len(told)), layout="constrained")
    axes = figure.subplots(len(told), 1, squeeze=False, sharex=True)[:, 0]
    for axis, (name, (turn, gap)) in zip(axes, told.items(), strict=True):
        step = max(1, len(gap) // _DRAWN)
        axis.plot(np.degrees(turn[::step]), _UM * gap[::step], ".", ms=1, color="0.6")
        middle, mean = _binned(turn, gap)
        axis.plot(np.degrees(middle), _UM * mean, "-", lw=1.2, color="C3")
        axis.set_ylabel("um")
        axis.set_title(name, fontsize=8, loc="left")
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("true turn of the table, degrees; red: mean of each 10 degrees")
    figure.savefig(folder / "residuals.png", dpi=110)
    _draw_harmonics(amplitudes, folder / "harmonics.png")
    return amplitudes


def _binned(turn: FloatArray, gap: FloatArray) -> tuple[FloatArray, FloatArray]:
    cell = np.floor(np.degrees(turn) / 10.0).astype(np.int64)
    cells, where = np.unique(cell, return_inverse=True)
    counts = np.bincount(where)
    told = counts >= _FEWEST
    mean, middle = (np.bincount(where, gap) / counts)[told], np.radians(10.0 * cells[told] + 5.0)
    breaks = np.flatnonzero(np.diff(middle) > _BROKEN_RAD) + 1
    return np.insert(middle, breaks, np.nan), np.insert(mean, breaks, np.nan)


def _draw_harmonics(amplitudes: Mapping[str, FloatArray], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / max(len(amplitudes), 1)
    orders = np.arange(1, _HARMONICS + 1)
    for number, (name, each) in enumerate(amplitudes.items()):
        if np.isnan(each).any():
            continue
        axis.bar(orders + (number - len(amplitudes) / 2) * width, _UM * each, width, label=name)
    axis.set_xticks(orders, [f"{k} a turn" for k in orders])
    axis.set_ylabel("amplitude, um")
    axis.set_title("1 a turn: eccentricity left over; 2 a turn: wobble", fontsize=9)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=7)
    figure.savefig(path, dpi=110)
