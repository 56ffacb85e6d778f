"""How a Grbl controller is brought to rest: gently where it can, else by a reset at standstill."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from drivers.grbl.conversation import (
    ANSWER_S,
    REPORT_S,
    Conversation,
    Lines,
    is_held,
    place_of,
    rests,
)
from drivers.grbl.messages import State, Status
from drivers.grbl.wire import Realtime

_POLL_S: Final = 0.05
_ENDING_OF: Final = {State.RUN: Realtime.HOLD, State.JOG: Realtime.JOG_CANCEL}


@dataclass(frozen=True, slots=True)
class Rest:
    """What came of it."""

    done: bool  # it stands, and no line is left that could start
    kept: bool = True  # and is where it was


def come_to_rest(talk: Conversation, ending: Realtime, within_s: float) -> Rest:
    """Say `ending`, watch until the controller stands with no line left.

    It is said again only for a line that had not been answered at the time: a jog cancel that
    arrives just after the jog's end leaves Grbl 1.1h suspended, idle and deaf to lines.
    """
    deadline_s = talk.clock() + within_s
    said = _say(talk, ending)
    before: Status | None = None
    while talk.clock() < deadline_s and not talk.dialogue.locked:
        status = talk.report(None, within_s=2 * _POLL_S)
        if status is not None:
            if is_held(status):
                return reset_held(talk, status)
            if status.state is State.HOME:
                return Rest(done=False)
            due = _ENDING_OF.get(status.state)
            if due is not None and said != (due, Lines.ANSWERED):
                said = _say(talk, due)
            elif before is not None and rests(before, status):
                # A line that was not answered could still start: a reset drops it.
                answered = talk.lines is Lines.ANSWERED
                return Rest(done=True) if answered else reset_held(talk, status)
            before = status
        talk.until(lambda: False, _POLL_S, None)
    return Rest(done=talk.dialogue.locked)


def reset_held(talk: Conversation, held: Status) -> Rest:
    """Reset where nothing moves: lines and queue are dropped, the position is kept."""
    if not talk.reset(None, within_s=ANSWER_S):
        return Rest(done=False)
    after = talk.report(None, within_s=REPORT_S)
    return Rest(done=True, kept=after is not None and place_of(after) == place_of(held))


def _say(talk: Conversation, ending: Realtime) -> tuple[Realtime, Lines]:
    lines = talk.lines
    talk.write(ending.wire)
    return ending, lines
