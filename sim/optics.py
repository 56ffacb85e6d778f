"""A laser line profiler looking at the part on the table, by ray casting.

Two rays a point: the beam from the emitter to the part, and from there to the camera. The sensor
is turned around the part. In its own frame, w ahead of the emitter and x across, a beam is

    z (1, u),    u = x / z of the beam in the sensor's plane

so that its parameter is the sensor's z, and x = z u. Everything is worked out in float64: with
float32 a beam now and then slips through a seam of the mesh, and steep surfaces turn to noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from sim.arrays import FloatArray
from sim.beams import first_met
from sim.hierarchy import arrange
from sim.readout import gauge, read_out
from sim.returns import Returns, returned
from sim.sensor import Flaws, Mounting, SeedKey, Sensor, SimProfile
from sim.shadows import hide
from sim.sheet import Section, Slicer
from sim.solids import Part
from sim.speckle import Speckle

_POINTS_AT_ONCE = 16384  # what the arrays of one go need fits a core's second cache
_CLEARANCE = 1e-5  # of the part's size: where the ray to the camera starts before the surface


@dataclass(frozen=True, slots=True, kw_only=True)
class OpticsSettings:
    """The whole bench."""

    mounting: Mounting = field(default_factory=Mounting)
    sensor: Sensor = field(default_factory=Sensor)
    flaws: Flaws = field(default_factory=Flaws)


class OpticalBench:
    """Profiles of one part. For one thread at a time; no answer depends on the order."""

    def __init__(self, part: Part, settings: OpticsSettings) -> None:
        self._settings = settings
        sensor, flaws = settings.sensor, settings.flaws
        self._slopes = np.linspace(-sensor.steepest, sensor.steepest, sensor.points)
        self._least = (flaws.faintest, math.cos(flaws.steepest_incidence_rad))
        self._clearance_mm = _CLEARANCE * part.size_mm
        self._faces = arrange(part)
        self._slicer = Slicer(part)
        self._section: tuple[float, Section] | None = None
        self._speckle = Speckle(flaws)
        self._gauge = gauge(sensor, flaws)
        # So that whatever must be compiled, or fetched, is so before anybody waits for a profile.
        self.profile(0.0, 0.0, SeedKey(0, 0))

    @property
    def settings(self) -> OpticsSettings:
        """What it was made with."""
        return self._settings

    def profile(self, table_rad: float, stage_mm: float, seed_key: SeedKey) -> SimProfile:
        """One profile with the table and the stage where they are."""
        return self.profiles([table_rad], stage_mm, [seed_key])[0]

    def profiles(
        self, table_rad: ArrayLike, stage_mm: float, seed_keys: Sequence[SeedKey]
    ) -> tuple[SimProfile, ...]:
        """Many profiles at one height: angles (k,), keys (k,) -> k profiles, as `profile` gives."""
        angles_rad = np.asarray(table_rad, np.float64)
        if angles_rad.shape != (len(seed_keys),):
            raise ValueError(f"optics: angles {angles_rad.shape}, but {len(seed_keys)} seed keys")
        mounting = self._settings.mounting
        height_mm = mounting.height_mm + mounting.lifting.value * stage_mm
        frames = self._frames(mounting.azimuth_rad - mounting.turning.value * angles_rad)
        step = max(1, _POINTS_AT_ONCE // self._settings.sensor.points)
        made: list[SimProfile] = []
        for start in range(0, len(seed_keys), step):
            light = self._lit(frames[start : start + step], height_mm)
            speckle = self._speckle.draw(seed_keys[start : start + step], len(self._slopes))
            made += read_out(light, self._slopes, speckle, self._gauge)
        return tuple(made)

    def _frames(self, turns_rad: FloatArray) -> FloatArray:
        """From the part's frame to each profile's, (k, 2, 3): (w, x) = frame @ (X, Y, 1)."""
        mounting = self._settings.mounting
        hand = float(mounting.hand.value)
        cosine, sine = np.cos(turns_rad), np.sin(turns_rad)
        frames = np.empty((len(turns_rad), 2, 3))
        frames[:, 0, 0], frames[:, 0, 1], frames[:, 0, 2] = -cosine, -sine, mounting.standoff_mm
        frames[:, 1, 0], frames[:, 1, 1] = -hand * sine, hand * cosine
        frames[:, 1, 2] = hand * mounting.side_mm
        return frames

    def _lit(self, frames: FloatArray, height_mm: float) -> Returns:
        """Where each beam first meets the part, and whether enough of it reaches the camera."""
        section = self._section_at(height_mm)
        met = first_met(section.ends_mm, frames, self._slopes)
        light = returned(
            (section.ends_mm, section.normals, section.reflectance),
            frames, self._slopes, self._least, met,
        )  # fmt: skip
        hide(
            (self._faces.boxes_mm, self._faces.corners_mm),
            frames, self._slopes, (height_mm, self._settings.sensor.rise_mm),
            light.z_mm - self._clearance_mm, light.reasons,
        )  # fmt: skip
        return light

    def _section_at(self, height_mm: float) -> Section:
        if self._section is None or self._section[0] != height_mm:
            self._section = (height_mm, self._slicer.at(height_mm))
        return self._section[1]
