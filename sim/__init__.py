"""The other end of the wire: parts, optics, motion and devices of a simulated station."""

from sim.motion import AxisMotion, Limits, Play, ScaledClock, Trajectory
from sim.optics import OpticalBench, OpticsSettings
from sim.parts import PARTS, find_part
from sim.sensor import Flaws, Mounting, Reason, SeedKey, Sensor, SimProfile
from sim.solids import Part, read_mesh

__all__ = [
    "PARTS",
    "AxisMotion",
    "Flaws",
    "Limits",
    "Mounting",
    "OpticalBench",
    "OpticsSettings",
    "Part",
    "Play",
    "Reason",
    "ScaledClock",
    "SeedKey",
    "Sensor",
    "SimProfile",
    "Trajectory",
    "find_part",
    "read_mesh",
]
