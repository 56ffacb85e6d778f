"""Grbl 1.1 and grblHAL: a table, a linear axis or a laser switch on a serial line of text."""

from __future__ import annotations

from drivers.grbl.axis import GrblAxis
from drivers.grbl.laser import GrblLaser
from drivers.grbl.settings import Homing, Settings

__all__ = ["GrblAxis", "GrblLaser", "Homing", "Settings"]
