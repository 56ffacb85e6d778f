"""A laser line profiler looking at the part on the table, by ray casting.

Two rays a point: the beam from the emitter to the part, and from there to the camera. Everything
happens in the part's frame; the sensor is turned around it instead of the part. A beam is

    E + z D,    D = (-1, u) turned,    u = x / z of the beam in the sensor's plane

so that its parameter is the sensor's z, and x = z u.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from sim.arrays import FloatArray, ReasonArray, SingleArray
from sim.sensor import Flaws, Mounting, Reason, SeedKey, Sensor, SimProfile
from sim.sheet import Sheet, cut, make_scene
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


@dataclass(frozen=True, slots=True, eq=False)
class _Beams:
    """Emitter and directions of k profiles in the part's frame; the sheet lies in z = 0."""

    emitter_mm: FloatArray  # (2, k, 1)
    direction: FloatArray  # (2, k, n)


@dataclass(frozen=True, slots=True, eq=False)
class _Returns:
    """What the light does, before the sensor adds anything: each (k, n)."""

    z_mm: FloatArray
    lean: FloatArray  # |normal . direction|: a shift along z moves the surface by lean times it
    brightness: FloatArray  # reflectance * cos(incidence)
    reasons: ReasonArray


class OpticalBench:
    """Profiles of one part. For one thread at a time; no answer depends on the order."""

    def __init__(self, part: Part, settings: OpticsSettings) -> None:
        self._part = part
        self._settings = settings
        sensor = settings.sensor
        self._slopes = np.linspace(-sensor.steepest, sensor.steepest, sensor.points)
        self._shortening = 1.0 / np.hypot(1.0, self._slopes)
        self._clearance_mm = _CLEARANCE * part.size_mm
        self._whole = make_scene(part.vertices_mm, part.faces)
        self._sheet: tuple[float, Sheet] | None = None
        self._speckle = Speckle(settings.flaws)

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
        turns_rad = mounting.azimuth_rad - mounting.turning.value * angles_rad
        step = max(1, _POINTS_AT_ONCE // self._settings.sensor.points)
        made: list[SimProfile] = []
        # A beam that misses has no z and no lean; its reason says so before either is used.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for start in range(0, len(seed_keys), step):
                beams = self._beams(turns_rad[start : start + step])
                light = self._lit(beams, height_mm)
                made += self._measured(light, seed_keys[start : start + step])
        return tuple(made)

    def _beams(self, turns_rad: FloatArray) -> _Beams:
        mounting = self._settings.mounting
        cosine, sine = np.cos(turns_rad)[:, None], np.sin(turns_rad)[:, None]
        u = mounting.hand.value * self._slopes
        along, across = mounting.standoff_mm, -mounting.side_mm
        emitter_mm = np.stack([cosine * along - sine * across, sine * along + cosine * across])
        direction = np.empty((2, len(turns_rad), len(u)))
        np.subtract(-cosine, sine * u, out=direction[0])
        np.add(-sine, cosine * u, out=direction[1])
        return _Beams(emitter_mm, direction)

    def _lit(self, beams: _Beams, height_mm: float) -> _Returns:
        """Where each beam first meets the part, and whether enough of it reaches the camera."""
        sheet, flaws = self._sheet_at(height_mm), self._settings.flaws
        dx, dy = beams.direction
        ex, ey = beams.emitter_mm
        rays = _rays(dx.shape, (ex, ey, 0.0), (dx, dy, 0.0))
        face = sheet.first_faces(*rays).reshape(dx.shape)
        # np.take with wrap is the quickest gather, and sends -1 to the row that is no face.
        a, b = np.take(sheet.a, face, mode="wrap"), np.take(sheet.b, face, mode="wrap")
        c_mm = np.take(sheet.c_mm, face, mode="wrap")
        reflectance = np.take(sheet.reflectance, face, mode="wrap")
        lean = a * dx
        lean += b * dy
        c_mm -= a * ex
        c_mm -= b * ey
        z_mm = np.divide(c_mm, lean, out=c_mm)
        np.abs(lean, out=lean)
        cosine = lean * self._shortening
        brightness = cosine * reflectance
        reasons = np.zeros(dx.shape, np.uint8)
        reasons[brightness < flaws.faintest] = Reason.DARK
        reasons[cosine < math.cos(flaws.steepest_incidence_rad)] = Reason.GRAZING
        reasons[face < 0] = Reason.NO_HIT
        self._hide(beams, z_mm, height_mm, reasons)
        return _Returns(z_mm, lean, brightness, reasons)

    def _hide(
        self, beams: _Beams, z_mm: FloatArray, height_mm: float, reasons: ReasonArray
    ) -> None:
        """Mark what the camera cannot see; the rays start a little before the surface."""
        dx, dy = beams.direction
        ex, ey = beams.emitter_mm
        before_mm = z_mm - self._clearance_mm
        origins_mm, directions = _rays(
            dx.shape,
            (ex + dx * before_mm, ey + dy * before_mm, height_mm),
            (-dx * before_mm, -dy * before_mm, self._settings.sensor.rise_mm),
        )
        lit = np.flatnonzero(reasons == Reason.MEASURED)
        if len(lit) < reasons.size:
            origins_mm, directions = origins_mm[lit], directions[lit]
        if not len(lit):
            return
        hidden = self._whole.run(origins_mm, directions, query="OCCLUDED") >= 0
        reasons.ravel()[lit[hidden]] = Reason.OCCLUDED

    def _measured(self, light: _Returns, keys: Sequence[SeedKey]) -> list[SimProfile]:
        """What the sensor makes of the light: noise, range, outliers, counts."""
        sensor, flaws = self._settings.sensor, self._settings.flaws
        normals, uniforms = self._speckle.draw(keys, sensor.points)
        z_mm, reasons = light.z_mm, light.reasons
        if normals is not None:
            z_mm = z_mm + normals * (0.25 * flaws.cloud_width_mm) / light.lean
        outside = (z_mm < sensor.near_mm) | (z_mm > sensor.far_mm)
        reasons[outside & (reasons != Reason.NO_HIT)] = Reason.OUT_OF_RANGE
        if uniforms is not None:
            stray = (uniforms < flaws.outlier_rate) & (reasons == Reason.MEASURED)
            reasons[stray] = Reason.OUTLIER
            # Given that it is one, the same draw, stretched, is uniform over the range.
            share = uniforms[stray] / np.float32(flaws.outlier_rate)
            z_mm[stray] = sensor.near_mm + share * (sensor.far_mm - sensor.near_mm)
        return self._counted(z_mm, light.brightness, reasons)

    def _counted(
        self, z_mm: FloatArray, brightness: FloatArray, reasons: ReasonArray
    ) -> list[SimProfile]:
        sensor = self._settings.sensor
        unseen = np.flatnonzero(reasons > Reason.OUTLIER)
        scaled = np.empty((*z_mm.shape, 2))
        x_slopes = self._slopes / sensor.x_mm_per_count
        scaled[..., 0] = z_mm * x_slopes - sensor.x_offset_mm / sensor.x_mm_per_count
        scaled[..., 1] = (z_mm - sensor.z_offset_mm) / sensor.z_mm_per_count
        scaled.reshape(-1, 2)[unseen] = 0.0
        intensity = brightness * self._settings.flaws.full_intensity
        intensity.ravel()[unseen] = 0.0
        counts = np.rint(scaled, out=scaled).astype(np.int32)
        shades = np.rint(intensity, out=intensity).astype(np.uint16)
        for each in (counts, shades, reasons):
            each.flags.writeable = False
        return [SimProfile(*row) for row in zip(counts, reasons, shades, strict=True)]

    def _sheet_at(self, height_mm: float) -> Sheet:
        if self._sheet is None or self._sheet[0] != height_mm:
            self._sheet = (height_mm, cut(self._part, height_mm))
        return self._sheet[1]


def _rays(
    shape: tuple[int, ...],
    origins_mm: Sequence[FloatArray | float],
    directions: Sequence[FloatArray | float],
) -> tuple[SingleArray, SingleArray]:
    """Lay columns out as embree takes them: two arrays (points, 3) of float32."""
    pair = []
    for columns in (origins_mm, directions):
        packed = np.empty((*shape, 3), np.float32)
        for axis, column in enumerate(columns):
            packed[..., axis] = column
        pair.append(packed.reshape(-1, 3))
    return pair[0], pair[1]
