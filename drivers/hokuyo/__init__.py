"""Hokuyo scanners in SCIP 2.0: profiles from polar scans, and the laser's switch, on one line."""

from drivers.hokuyo.laser import HokuyoLaser
from drivers.hokuyo.line import ScipLine
from drivers.hokuyo.profiler import Geometry, Hokuyo, Settings

__all__ = ["Geometry", "Hokuyo", "HokuyoLaser", "ScipLine", "Settings"]
