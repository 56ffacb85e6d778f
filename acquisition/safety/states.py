"""The station's states, what may happen in them, and what is known beside: values only.

::

    BOOT > DISCONNECTED > IDENTIFYING > SAFE > HOMING > READY > ARMING > ARMED > SCANNING
                                         ^       jog: MOVING     |  3 s, confirm     | pause, end
                                         '----- acknowledged ----+---- PAUSED, COMPLETING, STOPPING
    FAULT_* and ESTOP are latched: whatever goes on in them, only a person leads out, and never to
    ARMED. The laser is permitted in ARMED and SCANNING and nowhere else.

After ISO 13850 (a reset is a deliberate act and restarts nothing) and LinuxCNC's estop_latch (what
is not known to be well is a fault). Software is not the emergency stop: it reads, mirrors and
latches what the hardware has done.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto


class State(Enum):
    """Where the station stands."""

    BOOT = "boot"
    DISCONNECTED = "disconnected"
    IDENTIFYING = "identifying"
    SAFE = "safe, not homed"
    HOMING = "homing"
    READY = "ready"
    MOVING = "moving"
    CHECK = "checking a plan"
    ARMING = "arming"
    ARMED = "armed"
    SCANNING = "scanning"
    PAUSED = "paused"
    PAUSED_LINK = "paused, a link is lost"
    COMPLETING = "completing"
    STOPPING = "stopping"
    FAULT_CONFIG = "fault: configuration"
    FAULT_IDENTITY = "fault: identity"
    FAULT_COMM = "fault: communication"
    FAULT_HOMING = "fault: homing"
    FAULT_LASER = "fault: the laser is not seen to be off"
    FAULT_POSITION = "fault: position"
    FAULT_LIMIT = "fault: limit switch"
    FAULT_WATCHDOG = "fault: a watchdog bit"
    FAULT_STORAGE = "fault: storage"
    FAULT_INTERNAL = "fault: internal"
    ESTOP = "emergency stop or interlock"
    SHUTDOWN = "shut down"


FAULTS = frozenset(state for state in State if state.name.startswith("FAULT_"))
LATCHED = FAULTS | {State.ESTOP}
PERMITTING = frozenset({State.ARMED, State.SCANNING})
UNCONNECTED = frozenset({State.BOOT, State.DISCONNECTED, State.SHUTDOWN})


class Event(Enum):
    """What may happen: asked for by a person or program, reported, or gone wrong."""

    # asked for: refused where it does not fit
    CONNECT = auto()
    DISCONNECT = auto()
    HOME = auto()
    MOVE = auto()  # absolute: homed only
    JOG = auto()  # unhomed, the drivers bound it
    VALIDATE = auto()
    ARM = auto()
    CONFIRM = auto()
    CANCEL = auto()
    START = auto()
    PAUSE = auto()
    RESUME = auto()
    DISARM = auto()
    ACKNOWLEDGE = auto()
    STOP = auto()  # never refused
    CLOSE = auto()  # never refused
    # reported: where it does not fit somebody has lost track
    SELF_TESTED = auto()
    OFF_CONFIRMED = auto()
    IDENTIFIED = auto()
    HOMED = auto()
    HOMED_IN_PART = auto()  # one axis of two
    ARRIVED = auto()
    VALIDATED = auto()
    EXPOSED = auto()
    COMPLETE = auto()
    STANDS = auto()
    STANDS_ELSEWHERE = auto()  # at rest, its position lost
    CAUSE_GONE = auto()
    TICK = auto()
    # gone wrong: has a reaction everywhere
    ESTOP_PRESSED = auto()
    ESTOP_RELEASED = auto()
    INTERLOCK_OPENED = auto()
    INTERLOCK_CLOSED = auto()
    KEY_OFF = auto()
    KEY_ON = auto()
    LASER_LINK_LOST = auto()
    AXIS_LINK_LOST = auto()
    SENSOR_LINK_LOST = auto()
    OFF_UNCONFIRMED = auto()
    POSITION_LOST = auto()
    PLAN_REFUSED = auto()
    LIMIT_SWITCH = auto()
    WIRE_UNSOUND = auto()
    IDENTITY_WRONG = auto()
    HOMING_FAILED = auto()
    WATCHDOG_BIT = auto()
    STORAGE_FAILED = auto()
    BACK_PRESSURE = auto()
    CONFIG_INVALID = auto()
    CONTROL_LOST = auto()
    INTERNAL_ERROR = auto()


ASKED = frozenset(event for event in Event if event.value <= Event.CLOSE.value)
REPORTED = frozenset(
    event for event in Event if Event.CLOSE.value < event.value <= Event.TICK.value
)
WRONG = frozenset(Event) - ASKED - REPORTED


class Action(Enum):
    """What is to be done, in this order."""

    FORBID_LASER = "no on goes out any more, the lease ends"
    LASER_OFF = "off is sent and read back, whatever is believed"
    STOP_AXES = "both axes are told to stop"
    PERMIT_LASER = "the laser may be lit under the lease"
    ANNOUNCE = "an indicator: the laser may be lit soon"
    QUARANTINE = "the wires are silent until nothing late can come"
    ALARM = "the operator is told to press the emergency stop"
    REFUSE = "who asked is told that it is not done now"


AT_REST = (Action.FORBID_LASER, Action.LASER_OFF, Action.STOP_AXES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What a station may set of them."""

    warning_s: float = 3.0  # from the announcement until the laser may be lit
    confirm_s: float = 5.0  # after it: an arming that nobody confirms is over
    idle_s: float = 60.0  # armed and nothing exposed: disarmed
    resume_s: float = 60.0  # paused for longer: armed anew
    attended: bool = True  # who leaves pauses the scan; unattended nobody is there to leave


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """The state, and what must be remembered beside it."""

    state: State = State.BOOT
    since_s: float = -math.inf  # of the state; of the last exposure while armed
    identified: bool = False
    homed: bool = False  # positions may be trusted
    dark: bool = False  # off was confirmed since the last doubt; else it is "possibly on"
    estop_pressed: bool = False
    interlock_open: bool = False
    key_on: bool = True
    cause_gone: bool = False  # of a latched fault
    rearm: bool = False  # a pause that only arming ends

    @property
    def inputs_well(self) -> bool:
        """Whether hardware lets the laser be lit."""
        return self.key_on and not (self.estop_pressed or self.interlock_open)

    @property
    def laser_permitted(self) -> bool:
        """Whether the laser may be lit."""
        return self.state in PERMITTING and self.inputs_well
