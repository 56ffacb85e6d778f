"""The measured points of a scan, slice after slice, and what a file's header says of them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from acquisition.frames import part_points
from acquisition.poses import Sweep
from acquisition.scanfile import RECORD, ScanFolder
from drivers.profiler import Profile, Reason
from loftscan.following import describe
from loftscan.provenance import record as provenance
from reconstruction.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSlice:
    """One slice: n measured points of p profiles."""

    sweep: Sweep
    points_mm: FloatArray  # (n, 3), part frame
    intensity: NDArray[np.uint16]  # (n,), 0 where the sensor gave none
    profile: NDArray[np.int32]  # (n,), its number within the slice
    time_s: FloatArray  # (n,), of the station's clock


class MeasuredScan:
    """A scan for writing: one pass, slice by slice; damaged slices are left out and counted."""

    def __init__(self, folder: ScanFolder) -> None:
        self.folder = folder
        self.record = folder.record()
        self.name = folder.path.resolve().stem
        self.frame = str(json.loads((folder.path / RECORD).read_bytes())["frame"])
        self.slices = 0
        self.left_out: list[tuple[int, str]] = []

    def provenance(self, unit: str) -> dict[str, object]:
        """What was scanned with what, by whom the file was written; no path, no host."""
        kept = {"frame": self.frame, "calibration": self.record.calibration.kind.value}
        return {**provenance(describe(self.folder), kept), "unit": unit}

    def __iter__(self) -> Iterator[MeasuredSlice]:
        self.slices, self.left_out = 0, []
        for index in self.folder.indices():
            if (why := self.folder.damage_of(index)) is not None:
                self.left_out.append((index, why))
                continue
            self.slices += 1
            yield self._measured(self.folder.read(index))

    def _measured(self, sweep: Sweep) -> MeasuredSlice:
        counts = [int(np.count_nonzero(each.reasons == Reason.MEASURED)) for each in sweep.profiles]
        bright = [_intensity(each) for each in sweep.profiles]
        return MeasuredSlice(
            sweep,
            part_points(sweep, self.record.calibration),
            np.concatenate([np.empty(0, np.uint16), *bright]),
            np.repeat(np.arange(len(counts), dtype=np.int32), counts),
            np.repeat(np.array([each.time_s for each in sweep.poses]), counts),
        )


def library(name: str, ending: str) -> ModuleType:
    """A library of the extra ``exchange``; raises ValueError with the remedy where it is absent."""
    try:
        return import_module(name)
    except ImportError as absent:
        raise ValueError(
            f"{ending}: {name} is not installed; run: pip install 'loftscan[exchange]'"
        ) from absent


def _intensity(profile: Profile) -> NDArray[np.uint16]:
    measured = profile.reasons == Reason.MEASURED
    if not len(profile.intensity):
        return np.zeros(int(np.count_nonzero(measured)), np.uint16)
    return np.asarray(profile.intensity[measured], np.uint16)
