"""The home switch, the cam that presses it once a turn, and the four passes of `$H`.

::

                     cam_deg
    motor  ---------|#######|---------|####...      # the switch is pressed
           switch_deg                 one turn on

    seek fast --> | ... pull off <-- ... find slowly --> | ... pull off <-- : there is the origin

Machine zero lies a pull-off beyond the place where it comes to rest, or the travel below that when
it homes downward: by default all positions are negative.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from sim.grbl.numbers import single, steps_of
from sim.grbl.settings import Eeprom, GrblSettings

_SEEK_TRAVELS = 1.5
_FIND_PULL_OFFS = 5.0
_FEED, _SEEK, _PULL_OFF = 24, 25, 27
_TURN_DEG = 360.0
_LEAST_STEP = 1e-6  # of a step; closer to the cam than that is on it


class Aim(Enum):
    """What a pass of the cycle is for."""

    TO_SWITCH = "approach"
    OFF_SWITCH = "pull off"


@dataclass(frozen=True, slots=True)
class Pass:
    """One of the four ways, `way_deg` at most; what the firmware believes to be degrees."""

    aim: Aim
    way_deg: float  # signed
    rate_deg_min: float


def passes(eeprom: Eeprom) -> Iterator[Pass]:
    """Seek, pull off, find, pull off."""
    sign = -1.0 if eeprom.homes_downward else 1.0
    seek, feed, off = eeprom[_SEEK], eeprom[_FEED], eeprom[_PULL_OFF]
    yield Pass(Aim.TO_SWITCH, sign * _SEEK_TRAVELS * eeprom.travel_deg, seek)
    yield Pass(Aim.OFF_SWITCH, -sign * off, seek)
    yield Pass(Aim.TO_SWITCH, sign * _FIND_PULL_OFFS * off, feed)
    yield Pass(Aim.OFF_SWITCH, -sign * off, seek)


def origin_steps(eeprom: Eeprom) -> int:
    """What the place where it came to rest is called."""
    off_deg = eeprom[_PULL_OFF]
    if eeprom.homes_downward:
        return steps_of(single(off_deg - eeprom.travel_deg), eeprom.steps_per_deg)
    return steps_of(-off_deg, eeprom.steps_per_deg)


def pressed(motor_deg: float, settings: GrblSettings) -> bool:
    """Whether the cam presses the switch."""
    return (motor_deg - settings.switch_deg) % _TURN_DEG < settings.cam_deg


def steps_to_switch(motor_deg: float, way: float, settings: GrblSettings) -> int:
    """Whole true steps, unsigned, until the switch is pressed; `way` gives the direction."""
    if pressed(motor_deg, settings):
        return 0
    if way > 0.0:
        left_deg = (settings.switch_deg - motor_deg) % _TURN_DEG
    else:
        left_deg = (motor_deg - settings.switch_deg - settings.cam_deg) % _TURN_DEG
    return math.ceil(left_deg * settings.steps_per_deg - _LEAST_STEP)
