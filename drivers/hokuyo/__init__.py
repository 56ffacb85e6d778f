"""Hokuyo scanners in SCIP 2.0: profiles from polar scans, and the laser's switch, on one line."""

from drivers.hokuyo.laser import HokuyoLaser
from drivers.hokuyo.line import ScipLine
from drivers.hokuyo.profiler import MM_PER_COUNT, Geometry, Hokuyo, Settings

__all__ = ["MM_PER_COUNT", "Geometry", "Hokuyo", "HokuyoLaser", "ScipLine", "Settings"]
