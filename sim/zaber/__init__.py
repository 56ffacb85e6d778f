"""Zaber devices with firmware 7 on one chain, each with one axis."""

from sim.zaber.chain import ZaberChain
from sim.zaber.device import ZaberDevice, ZaberSettings

__all__ = ["ZaberChain", "ZaberDevice", "ZaberSettings"]
