"""The safety chain on the inputs of an I/O block: closed contacts read 1, so a broken wire is 0."""

from __future__ import annotations

from drivers.bus import Bus
from drivers.inputs import Inputs
from drivers.relay.registers import Register


class BlockInputs:
    """Some of the block's first 16 inputs; None for what is not wired."""

    def __init__(
        self,
        bus: Bus,
        device_id: int,
        *,
        estop: int | None = None,
        interlock: int | None = None,
        key: int | None = None,
    ) -> None:
        for name, number in (("estop", estop), ("interlock", interlock), ("key", key)):
            if number is not None and number not in range(16):
                raise ValueError(f"{name}: input {number}; the block's first word has 0 to 15")
        self._bus = bus
        self._device_id = device_id
        self._estop = estop
        self._interlock = interlock
        self._key = key

    def read(self) -> Inputs:
        """Read the block's first word of inputs."""
        (word,) = self._bus.read_holding(self._device_id, Register.INPUTS, 1)

        def closed(number: int | None) -> bool:
            return number is None or bool(word >> number & 1)

        return Inputs(
            estop_pressed=not closed(self._estop),
            interlock_open=not closed(self._interlock),
            key_on=closed(self._key),
        )
