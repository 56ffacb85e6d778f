"""What the hardware's safety chain says: emergency stop, interlock, key; read, never written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Inputs:
    """One reading; what is not wired is well."""

    estop_pressed: bool = False
    interlock_open: bool = False
    key_on: bool = True


class SafetyInputs(Protocol):
    """Whoever can read them."""

    def read(self) -> Inputs:
        """Read them now.

        Raises
        ------
        DriverError
            They cannot be read, which is no sign of health.
        """
        ...
