"""A RIFTEK RF62X as a profiler: HTTP for who and how, UDP for the profiles.

The sensor streams to the host and port set on its page, measuring by itself or once a software
trigger. Its datagrams say their own scale; where its z = 0 stands to the station is a setting. It
has no documented switch of its laser.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from drivers.axis import Identity
from drivers.errors import NoReply, Refused
from drivers.links import ByteLink
from drivers.profiler import Profile, Reason, Tally
from drivers.riftek.web import WebApi
from drivers.riftek.wire import BadFrame, Event, Gap, Pixels, ProfileMessage, Stream

RATES_HZ = range(1, 20_001)
EXPOSURES_US = (3.0, 300_000.0)
_EXPOSURE_STEP_NS = 100
_SLICE_S = 0.05  # the longest single wait
_MOST_WAITING = 32_768  # datagrams: above what a socket's buffer holds
_RF62X = range(620, 630)
_PROFILE_FORMAT = 17
_WHO = ("fact_general_deviceType", "fact_general_serial", "fact_general_firmwareVer")
_STREAM = ("user_streams_udpEnabled", "user_streams_format")


class Sync(Enum):
    """What starts a measurement: the value of user_sensor_syncSource."""

    INTERNAL = 0
    SOFTWARE = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What is added to the sensor's mm, and what is written to it; None is left as it is.

    Raises
    ------
    ValueError
        Out of the sensor's bounds; one line.
    """

    x_offset_mm: float = 0.0
    z_offset_mm: float = 0.0
    rate_hz: int | None = None
    exposure_us: float | None = None
    sync: Sync = Sync.INTERNAL
    serial: int | None = None  # whose datagrams are taken; None: any

    def __post_init__(self) -> None:
        for name in ("x_offset_mm", "z_offset_mm"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)}; write a finite number")
        if self.rate_hz is not None and self.rate_hz not in RATES_HZ:
            raise ValueError(
                f"rate_hz: {self.rate_hz}; the sensor takes whole numbers from {RATES_HZ[0]} to"
                f" {RATES_HZ[-1]}"
            )
        low_us, high_us = EXPOSURES_US
        if self.exposure_us is not None and not low_us <= self.exposure_us <= high_us:
            raise ValueError(
                f"exposure_us: {self.exposure_us}; write a number from {low_us:g} to {high_us:g}"
            )

    @property
    def parameters(self) -> Mapping[str, int]:
        """What is written, by the sensor's names and in its units."""
        told: dict[str, int] = {}
        if self.rate_hz is not None:
            told["user_sensor_framerate"] = self.rate_hz
        if self.exposure_us is not None:
            steps = round(self.exposure_us * 1000.0 / _EXPOSURE_STEP_NS)
            told["user_sensor_exposure1"] = steps * _EXPOSURE_STEP_NS
        if self.sync is Sync.SOFTWARE:
            told["user_sensor_syncSource"] = self.sync.value
        return told


@dataclass(frozen=True, slots=True)
class Loss:
    """What a stream lost, as told by the sensor's two counts."""

    profiles: int = 0  # that came
    lost: int = 0  # packet counts that never came
    unsent: int = 0  # measured, by the measure count, and not sent
    pixels: int = 0  # lines in pixels, of no use to a scan
    bad: int = 0
    strangers: int = 0  # of another sensor


class Riftek:
    """A `drivers.profiler.Profiler`; `link` is closed by whoever opened it."""

    def __init__(
        self,
        web: WebApi,
        link: ByteLink,
        settings: Settings,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._web = web
        self._link = link
        self._settings = settings
        self._clock = clock
        self._stream = Stream()
        self._waiting: deque[Profile] = deque()
        self._loss = Loss()
        self._triggered = False

    def identify(self) -> Identity:
        """Ask the sensor who it is, and whether it streams profiles.

        Raises
        ------
        Refused
            Another device, or a stream that is off or of pixels; says what to set.
        """
        said = self._web.values((*_WHO, *_STREAM))
        kind = said.get("fact_general_deviceType")
        if kind not in _RF62X:
            raise Refused(
                f"riftek at {self._web.address}: device type {kind}, not an RF62X; is the address"
                " right?"
            )
        if said.get("user_streams_udpEnabled") == 0:
            raise Refused(
                f"riftek at {self._web.address}: its UDP stream is off; switch it on, on its page"
            )
        if said.get("user_streams_format", _PROFILE_FORMAT) != _PROFILE_FORMAT:
            raise Refused(
                f"riftek at {self._web.address}: it streams pixels; set its stream to profiles"
            )
        version = said.get("fact_general_firmwareVer", "")
        firmware = ".".join(map(str, version)) if isinstance(version, list) else str(version)
        serial = str(said.get("fact_general_serial", ""))
        return Identity(family="riftek", model=f"RF{kind}", firmware=firmware, serial=serial)

    def set_up(self) -> None:
        """Write what the settings name, and read it back.

        Raises
        ------
        Refused
            The sensor's own word.
        """
        if parameters := self._settings.parameters:
            self._web.put(parameters)

    def profiles(self, timeout_s: float) -> Iterator[Profile]:
        """Yield profiles as they come, oldest first; each triggered where software does.

        Raises
        ------
        NoReply
            No profile came for `timeout_s`; says what came instead and what to check.
        """
        since_s, before = self._clock(), self._loss
        while True:
            if self._waiting:
                self._triggered = False
                yield self._waiting.popleft()
                since_s, before = self._clock(), self._loss
                continue
            self._trigger()
            left_s = since_s + timeout_s - self._clock()
            heard = self._listen(min(max(left_s, 0.0), _SLICE_S))
            # What is there already is taken first, but not for ever.
            if not self._waiting and left_s <= (-_SLICE_S if heard else 0.0):
                raise NoReply(self._silence(timeout_s, before))

    def discard(self) -> None:
        """Throw away what has arrived; the numbering begins anew, so that no loss is counted."""
        for _ in range(_MOST_WAITING):
            if not self._link.read(0.0):
                break
        self._waiting.clear()
        self._stream.restart()
        self._triggered = False

    def tally(self) -> Tally:
        """What was lost so far."""
        loss = self._loss
        return Tally(loss.profiles, loss.lost, 0, loss.bad)

    def loss(self) -> Loss:
        """What the sensor's own counts tell."""
        return self._loss

    def _trigger(self) -> None:
        """Trigger once a profile, whatever becomes of the answer."""
        if self._settings.sync is Sync.SOFTWARE and not self._triggered:
            self._triggered = True
            self._web.capture()

    def _listen(self, timeout_s: float) -> bool:
        datagram = self._link.read(timeout_s)
        if datagram:
            for event in self._stream.feed(datagram):
                self._take(event)
        return bool(datagram)

    def _take(self, event: Event) -> None:
        loss = self._loss
        match event:
            case ProfileMessage():
                if self._is_strange(event):
                    self._loss = replace(loss, strangers=loss.strangers + 1)
                    return
                self._loss = replace(loss, profiles=loss.profiles + 1)
                self._waiting.append(profile_of(event, self._settings))
            case Gap():
                self._loss = replace(
                    loss, lost=loss.lost + event.lost, unsent=loss.unsent + event.unsent
                )
            case Pixels():
                self._loss = replace(loss, pixels=loss.pixels + 1)
            case BadFrame():
                self._loss = replace(loss, bad=loss.bad + 1)

    def _is_strange(self, message: ProfileMessage) -> bool:
        return self._settings.serial not in (None, message.serial)

    def _silence(self, timeout_s: float, before: Loss) -> str:
        start, now = f"riftek at {self._link.address}: no profile in {timeout_s:g} s", self._loss
        if now.pixels > before.pixels:
            return f"{start}, only lines in pixels; set its stream's format to profiles (17)"
        if now.strangers > before.strangers:
            return f"{start}, only another sensor's; give each sensor a port of its own"
        if now.bad > before.bad:
            return f"{start}, only bytes that are no profile of it; does another device send here?"
        return (
            f"{start}; is the laser on, the trigger running, and this host's address and port set"
            " in the sensor's network settings?"
        )


def profile_of(message: ProfileMessage, settings: Settings) -> Profile:
    """Return the profile of a datagram; where z is 0 nothing came back."""
    counts = np.column_stack([message.x, message.z]).astype(np.int32)
    return Profile(
        counts=counts,
        scale_mm=(message.x_scale_mm, message.z_scale_mm),
        offset_mm=(settings.x_offset_mm, settings.z_offset_mm),
        reasons=np.where(message.z == 0, Reason.NO_RETURN, Reason.MEASURED).astype(np.uint8),
        intensity=message.intensity.astype(np.uint16),
        sensor_time_s=message.system_time * 1e-9,
        encoder=message.step,
        frame=message.packet,
    )
