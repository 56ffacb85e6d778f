"""What the firmware says, line by line, without the ends of the lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim.grbl.numbers import MM_PER_INCH, printed

BANNER = "\r\nGrbl 1.1h ['$' for help]"
HAL_BANNER = "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]"
HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"
UNLOCK_FIRST = "[MSG:'$H'|'$X' to unlock]"
UNLOCKED = "[MSG:Caution: Unlocked]"
RESET_FIRST = "[MSG:Reset to continue]"
CHECK_LIMITS = "[MSG:Check Limits]"
PROGRAM_ENDED = "[MSG:Pgm End]"
RX_BUFFER = 128  # bytes

_OFFSET_EVERY = {False: 10, True: 30}  # reports, standing and moving
_OVERRIDES_EVERY = {False: 10, True: 20}


@dataclass(frozen=True, slots=True)
class Format:
    """How numbers are told: in inches if `$13` says so, one for each axis of the board."""

    axes: int
    index: int  # of the axis that turns the table; the others stand at 0
    inches: bool

    def coordinate(self, value_deg: float) -> str:
        """One coordinate."""
        return printed(value_deg / MM_PER_INCH, 4) if self.inches else printed(value_deg, 3)

    def coordinates(self, value_deg: float) -> str:
        """One for each axis."""
        values_deg = [value_deg if index == self.index else 0.0 for index in range(self.axes)]
        return ",".join(map(self.coordinate, values_deg))

    def rate(self, value_deg_min: float) -> str:
        """A feed rate."""
        if self.inches:
            return printed(value_deg_min / MM_PER_INCH, 1)
        return printed(value_deg_min, 0)


def build_info(axes: str, blocks: int, *, hal: bool = False) -> list[str]:
    """The lines of `$I`; a board of more than three axes says which, as grblHAL does."""
    more = [f"[AXS:{len(axes)}:{axes}]"] if len(axes) > 3 else []
    if hal:
        return [
            "[VER:1.1f.20260817:]", f"[OPT:VNML+,100,1024,{len(axes)},0]", *more,
            "[NEWOPT:ENUMS,RT+,HOME,TC,SED]", "[FIRMWARE:grblHAL]", "[NVS STORAGE:*EEPROM]",
            "[DRIVER:Simulator]", "[DRIVER VERSION:260324]",
        ]  # fmt: skip
    return ["[VER:1.1h.20190830:]", f"[OPT:V,{blocks},{RX_BUFFER}]", *more]


def parameters(systems_deg: dict[int, float], g92_deg: float, form: Format) -> list[str]:
    """The lines of `$#`."""
    stored = systems_deg | {28: 0.0, 30: 0.0, 92: g92_deg}
    lines = [f"[G{number}:{form.coordinates(value)}]" for number, value in stored.items()]
    nothing = form.coordinates(0.0)
    return [*lines, f"[TLO:{form.coordinate(0.0)}]", f"[PRB:{nothing}:0]"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What one status report is made of."""

    label: str
    busy: bool
    position_deg: float
    offset_deg: float
    free_blocks: int
    free_bytes: int
    rate_deg_min: float
    speed_rpm: float
    pin: str
    overrides: Sequence[int]
    accessories: str


class StatusReports:
    """Status reports, and which of their rare fields are due."""

    def __init__(self) -> None:
        self._offset_in = 0
        self._overrides_in = 0

    def offset_changed(self) -> None:
        """Tell the work offset in the next report."""
        self._offset_in = 0

    def overrides_changed(self) -> None:
        """Tell the overrides in the next report."""
        self._overrides_in = 0

    def report(self, seen: Seen, mask: int, form: Format) -> str:
        """Answer one `?`; `mask` is `$10`: machine position, buffers."""
        work = 0.0 if mask & 1 else seen.offset_deg
        name = "MPos" if mask & 1 else "WPos"
        fields = [seen.label, f"{name}:{form.coordinates(seen.position_deg - work)}"]
        if mask & 2:
            fields.append(f"Bf:{seen.free_blocks},{seen.free_bytes}")
        fields.append(f"FS:{form.rate(seen.rate_deg_min)},{printed(seen.speed_rpm, 0)}")
        fields += [f"Pn:{seen.pin}"] if seen.pin else []
        return f"<{'|'.join(fields + self._rare(seen, form))}>"

    def _rare(self, seen: Seen, form: Format) -> list[str]:
        fields = []
        if self._offset_in:
            self._offset_in -= 1
        else:
            self._offset_in = _OFFSET_EVERY[seen.busy] - 1
            self._overrides_in = self._overrides_in or 1  # never both in one report
            fields.append(f"WCO:{form.coordinates(seen.offset_deg)}")
        if self._overrides_in:
            self._overrides_in -= 1
            return fields
        self._overrides_in = _OVERRIDES_EVERY[seen.busy] - 1
        fields.append("Ov:" + ",".join(map(str, seen.overrides)))
        fields += [f"A:{seen.accessories}"] if seen.accessories else []
        return fields
