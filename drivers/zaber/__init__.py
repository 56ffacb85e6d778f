"""Zaber devices of firmware 6 and 7 on a chain: a rotary table or a linear stage, in ASCII."""

from drivers.zaber.axis import ZaberAxis
from drivers.zaber.chain import Chain
from drivers.zaber.settings import Settings

__all__ = ["Chain", "Settings", "ZaberAxis"]
