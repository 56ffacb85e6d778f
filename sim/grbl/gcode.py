"""From characters to words and from words to a block: the pure half of the firmware's parser.

Modes carry the numbers that G-code gives them, ``G91`` is `distance` 91. Not here, and refused with
``error:20``: arcs, probing, tool lengths, G28 and G30, inverse time.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from sim.grbl.numbers import read_number
from sim.grbl.refusal import Error, Refusal

_LINE_BUFFER = 80  # with the end of the line
_HIGHEST_LINE_NUMBER, _HIGHEST_TOOL = 10_000_000, 255
_VALUES = "FIJKLNPRST"
_NEVER_NEGATIVE = "FNPTS"

# Commands that take the axis words for themselves: one a line.
_AXIS_COMMANDS = {0.0: "motion", 1.0: "motion", 10.0: "offset", 92.0: "offset", 49.0: "tool"}
_G_GROUPS = {
    0.0: "motion", 1.0: "motion", 80.0: "motion",
    4.0: "action", 10.0: "action", 53.0: "action", 92.0: "action", 92.1: "action",
    17.0: "plane", 18.0: "plane", 19.0: "plane",
    20.0: "units", 21.0: "units",
    40.0: "cutter", 49.0: "tool_length", 61.0: "path", 91.1: "arcs",
    **dict.fromkeys((54.0, 55.0, 56.0, 57.0, 58.0, 59.0), "system"),
    90.0: "distance", 91.0: "distance", 94.0: "feed_mode",
}  # fmt: skip
_G_FRACTIONS = (61, 90, 91, 92)  # with a fraction they are unsupported, the others no integers
_M_GROUPS = {
    0: "flow", 1: "flow", 2: "flow", 30: "flow",
    3: "spindle", 4: "spindle", 5: "spindle", 8: "coolant", 9: "coolant",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Modes:
    """What stays until it is changed; as after a reset."""

    motion: int = 0
    system: int = 54
    plane: int = 17
    units: int = 21
    distance: int = 90
    feed_mode: int = 94
    spindle: int = 5
    coolant: int = 9

    def ended(self) -> Modes:
        """What M2 and M30 leave of them."""
        return Modes(motion=1, units=self.units)

    def report(self, tool: int, feed: str, speed: str) -> str:
        """The line of `$G`."""
        return (
            f"[GC:G{self.motion} G{self.system} G{self.plane} G{self.units} G{self.distance}"
            f" G{self.feed_mode} M{self.spindle} M{self.coolant} T{tool} F{feed} S{speed}]"
        )


@dataclass(frozen=True, slots=True)
class Block:
    """One line, read and not yet checked."""

    modes: Modes  # as they will be
    groups: frozenset[str] = frozenset()
    action: float | None = None
    axis_command: str | None = None
    flow: int | None = None
    values: dict[str, float] = field(default_factory=dict)


class LineBuffer:
    """Characters to lines: no blanks, no comments, capitals."""

    def __init__(self) -> None:
        self._line, self._comment, self._overflown = "", "", False

    def take(self, byte: int) -> str | None:
        """Take a character; at the end of a line return it.

        Raises
        ------
        Refusal
            A line that ends here was too long.
        """
        if byte in b"\r\n":
            return self._end()
        char = chr(byte)
        if self._comment or self._overflown:
            if self._comment == "(" and char == ")":
                self._comment = ""
        elif char in "(;":
            self._comment = char
        elif char > " " and char != "/":
            self._overflown = len(self._line) >= _LINE_BUFFER - 1
            self._line += "" if self._overflown else char.upper()
        return None

    def _end(self) -> str:
        line, overflown = self._line, self._overflown
        self._line, self._comment, self._overflown = "", "", False
        if overflown:
            raise Refusal(Error.LINE_TOO_LONG)
        return line


def read_block(line: str, axes: str, modes: Modes) -> Block:
    """Read the words of a line.

    Raises
    ------
    Refusal
        Malformed, unsupported, repeated, or commands that exclude each other.
    """
    block, at = Block(modes), 0
    while at < len(line):
        letter = line[at]
        if not "A" <= letter <= "Z":
            raise Refusal(Error.LETTER_EXPECTED)
        value, at = read_number(line, at + 1)
        if letter == "G":
            block = _with_g(block, value)
        elif letter == "M":
            block = _with_m(block, value)
        else:
            block = _with_value(block, letter, value, axes)
    return block


def _with_g(block: Block, value: float) -> Block:
    number = round(value, 2)
    group = _G_GROUPS.get(number)
    if group is None:
        whole = float(int(number))
        integer_wanted = whole in _G_GROUPS and int(number) not in _G_FRACTIONS
        raise Refusal(Error.NOT_AN_INTEGER if integer_wanted else Error.UNSUPPORTED)
    if command := _AXIS_COMMANDS.get(number):
        if block.axis_command:
            raise Refusal(Error.AXIS_COMMANDS_CONFLICT)
        block = replace(block, axis_command=command)
    block = _grouped(block, group)
    if group == "action":
        return replace(block, action=number)
    if group in ("cutter", "tool_length", "path", "arcs"):
        return block  # the only mode of its group that is supported
    return replace(block, modes=replace(block.modes, **{group: int(number)}))


def _with_m(block: Block, value: float) -> Block:
    number = int(value)
    if value != number:
        raise Refusal(Error.NOT_AN_INTEGER)
    if number not in _M_GROUPS:
        raise Refusal(Error.UNSUPPORTED)
    group = _M_GROUPS[number]
    block = _grouped(block, group)
    if group == "flow":
        return replace(block, flow=None if number == 1 else number)  # M1 is ignored
    return replace(block, modes=replace(block.modes, **{group: number}))


def _grouped(block: Block, group: str) -> Block:
    if group in block.groups:
        raise Refusal(Error.MODAL_GROUP_TWICE)
    return replace(block, groups=block.groups | {group})


def _with_value(block: Block, letter: str, value: float, axes: str) -> Block:
    if letter not in _VALUES and letter not in axes:
        raise Refusal(Error.UNSUPPORTED)
    if letter == "T" and value > _HIGHEST_TOOL:
        raise Refusal(Error.TOOL_TOO_HIGH)
    if letter in block.values:
        raise Refusal(Error.WORD_REPEATED)
    if letter in _NEVER_NEGATIVE and value < 0.0:
        raise Refusal(Error.NEGATIVE_VALUE)
    if letter == "N" and value > _HIGHEST_LINE_NUMBER:
        raise Refusal(Error.LINE_NUMBER_TOO_HIGH)
    return replace(block, values={**block.values, letter: value})
