"""Grbl 1.1 and grblHAL: a rotary table or a linear axis on a serial line of text."""

from __future__ import annotations

from drivers.grbl.axis import GrblAxis
from drivers.grbl.settings import Homing, Settings

__all__ = ["GrblAxis", "Homing", "Settings"]
