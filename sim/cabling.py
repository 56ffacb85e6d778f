"""A station's cables, with everything that was planted in them.

::

    device -- Silent -- Garbling -- FaultyLine --> its wire
              counts    counts      rolls dice
"""

from __future__ import annotations

import random
from collections.abc import Callable

from sim.device import Broadcaster, Device
from sim.faults import Breath, Dropping, Faults, Garbling, Silent, Speaker, Unsent
from sim.faulty_wire import FaultyLine, FaultyNetwork, Plug
from sim.wire_faults import Carrier
from sim.witness import Witness


class Cabling:
    """One cable a device; a device's connections, and its datagrams, share it.

    Parameters
    ----------
    seed
        Each cable rolls dice of its own, which follow from it.
    witness
        Is told of what dice did: ``{"what": "wire", "wire": "stage", "fault": "late"}``.
    """

    def __init__(self, faults: Faults, seed: int, witness: Witness) -> None:
        self._faults = faults
        self._seed = seed
        self._witness = witness
        self._pulling = random.Random(f"{seed} pulling")
        self._plugs = {speaker: self._plug(speaker.value) for speaker in Speaker}

    def pull_any(self, now_s: float) -> None:
        """Pull a cable, any one."""
        self._pulling.choice(list(self._plugs.values())).pull(now_s)

    def pull(self, *speakers: Speaker, now_s: float) -> None:
        """Pull these cables together."""
        for plug in {self._plugs[speaker] for speaker in speakers}:
            plug.pull(now_s)

    def serial(self, device: Device, *speakers: Speaker) -> Device:
        """Lay a serial line to a device, or to several that share it: one cable."""
        for speaker in speakers:
            self._plugs[speaker] = self._plugs[speakers[0]]
            breath = self._breath(speaker)
            if breath is not None:
                device = Silent(device, breath)
        if self._faults.garble_every:
            device = Garbling(device, self._faults.garble_every)
        first = speakers[0]
        return self._laid(device, first, Carrier.SERIAL, self._dice(first, "serial"))

    def tcp(self, speaker: Speaker, breath: Breath | None = None) -> Callable[[Device], Device]:
        """Lay a TCP cable; what is returned puts a session on it. All share one breath."""
        breath, dice = breath or self._breath(speaker), self._dice(speaker, "tcp")

        def session(device: Device) -> Device:
            if breath is not None:
                device = Silent(device, breath)
            return self._laid(device, speaker, Carrier.TCP, dice)

        return session

    def network(self, source: Broadcaster, speaker: Speaker) -> Broadcaster:
        """Lay the cable of somebody who sends datagrams."""
        if not self._faults.profiles:
            source = Unsent(source)
        if self._faults.drop_every:
            source = Dropping(source, self._faults.drop_every)
        dice = self._dice(speaker, "udp")
        return FaultyNetwork(source, self._faults.wires, self._plugs[speaker], dice)

    def _laid(
        self, device: Device, speaker: Speaker, carrier: Carrier, dice: random.Random
    ) -> Device:
        return FaultyLine(device, self._faults.wires, carrier, self._plugs[speaker], dice)

    def _breath(self, speaker: Speaker) -> Breath | None:
        answers = self._faults.silent_after.get(speaker)
        return None if answers is None else Breath(answers)

    def _dice(self, speaker: Speaker, way: str) -> random.Random:
        return random.Random(f"{self._seed} {speaker.value} {way}")

    def _plug(self, name: str) -> Plug:
        wires = self._faults.wires
        return Plug(
            name,
            away_s=wires.away_s,
            pulled_after_s=wires.unplug_after_s.get(name),
            note=lambda time_s, fault: self._witness.note(time_s, "wire", wire=name, fault=fault),
        )
