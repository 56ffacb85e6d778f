"""Tables of station.toml for profilers of other families than the first: [profiler]."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, ClassVar

from acquisition.settings import Key
from drivers import hokuyo, register_profiler, riftek, sick
from drivers.addresses import SerialAddress, parse_address
from drivers.profiler import Reason
from drivers.register_profiler import Flag, Layout, Packing, Table, Trigger, must_tell_torn_reads

_MODBUS = Key(
    "the bus the sensor is on; Modbus devices with one address share it",
    starts=("serial://", "tcp://"),
    parse=parse_address,
)
_RATE = Key("profiles a second", above=0.0)
_REGISTER = 0xFFFF


def _missing(why: str) -> Key:
    return Key(f"the value that stands for {why}; absent: none does")


def _register(meaning: str) -> Key:
    return Key(meaning, at_least=0, at_most=_REGISTER)


class WordOrder(Enum):
    """Which of two registers has the high word."""

    HIGH_FIRST = "high first"
    LOW_FIRST = "low first"


class RiftekTrigger(Enum):
    """What starts a measurement."""

    SENSOR = "sensor"  # by itself, at its own rate
    SOFTWARE = "software"  # asked for over HTTP


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterProfiler:
    """Any profiler whose columns stand in Modbus registers."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "registers"
    address: Annotated[str, _MODBUS]
    device_id: Annotated[int, Key("the sensor's Modbus id", at_least=0, at_most=255)] = 1
    function: Annotated[
        int, Key("4 reads input registers, 3 holding registers", at_least=3, at_most=4)
    ] = 4
    first_register: Annotated[int, _register("of the first column, as sent: from 0")]
    rate_hz: Annotated[float, _RATE]
    points_per_profile: Annotated[int, Key("columns", at_least=1, at_most=_REGISTER + 1)]
    words_per_value: Annotated[
        int, Key("registers that a column fills, 1 or 2", at_least=1, at_most=2)
    ] = 1
    word_order: Annotated[WordOrder, Key("of two: high first, or low first")] = WordOrder.HIGH_FIRST
    signed: Annotated[bool, Key("true: two's complement")] = False
    z_mm_per_count: Annotated[float, Key("scale of a value; below 0 where it falls as z grows")]
    z_offset_mm: Annotated[float, Key("added to z after scaling")] = 0.0
    column_pitch_mm: Annotated[float, Key("from a column to the next; below 0 where x falls")]
    first_column_mm: Annotated[float, Key("x of the first column")] = 0.0
    no_return_value: Annotated[int | None, _missing("too little light")] = None
    saturated_value: Annotated[int | None, _missing("too much light")] = None
    out_of_range_value: Annotated[int | None, _missing("too near or too far")] = None
    unknown_value: Annotated[int | None, _missing("no measurement, and no more is said")] = None
    sequence_register: Annotated[
        int | None, _register("counts profiles: a torn read is seen by it, and read again")
    ] = None
    ready_register: Annotated[int | None, _register("has the flag that a profile is there")] = None
    ready_bit: Annotated[int, Key("of that register, 0 the lowest", at_least=0, at_most=15)] = 0
    trigger_register: Annotated[
        int | None, _register("holding register written for each profile; it holds until the next")
    ] = None
    trigger_value: Annotated[int, _register("what is written there")] = 1

    def __post_init__(self) -> None:
        must_tell_torn_reads(self.layout)

    @property
    def layout(self) -> Layout:
        """What the driver must know; ValueError where it cannot be."""
        ready = None if self.ready_register is None else Flag(self.ready_register, self.ready_bit)
        trigger = None
        if self.trigger_register is not None:
            trigger = Trigger(self.trigger_register, self.trigger_value)
        values = {
            Reason.NO_RETURN: self.no_return_value,
            Reason.SATURATED: self.saturated_value,
            Reason.OUT_OF_RANGE: self.out_of_range_value,
            Reason.UNKNOWN: self.unknown_value,
        }
        return Layout(
            table=Table(self.function),
            first_register=self.first_register,
            columns=self.points_per_profile,
            packing=Packing.WORD if self.words_per_value == 1 else Packing.TWO_WORDS,
            word_order=register_profiler.WordOrder[self.word_order.name],
            signed=self.signed,
            z_mm_per_count=self.z_mm_per_count,
            z_offset_mm=self.z_offset_mm,
            column_pitch_mm=self.column_pitch_mm,
            first_column_mm=self.first_column_mm,
            missing=tuple((value, why) for why, value in values.items() if value is not None),
            sequence_register=self.sequence_register,
            ready=ready,
            trigger=trigger,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class BannerEzArray:
    """A Banner EZ-ARRAY light screen: which of its channels the part blocks."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "banner_ez_array"
    address: Annotated[str, _MODBUS]
    device_id: Annotated[int, Key("the screen's Modbus id", at_least=1, at_most=247)] = 65
    rate_hz: Annotated[float, Key("scans a second", above=0.0)]
    points_per_profile: Annotated[int, Key("channels", at_least=1, at_most=480)]
    channel_pitch_mm: Annotated[float, Key("from a channel to the next; below 0 where x falls")]
    first_channel_mm: Annotated[float, Key("x of the first channel")] = 0.0

    def __post_init__(self) -> None:
        must_tell_torn_reads(self.layout)

    @property
    def layout(self) -> Layout:
        """What the driver must know."""
        return register_profiler.ez_array(
            self.points_per_profile, self.channel_pitch_mm, first_channel_mm=self.first_channel_mm
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Riftek:
    """A RIFTEK RF62X profiler: HTTP for setup and trigger, profiles by UDP."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "riftek"
    address: Annotated[str, Key("the sensor's HTTP port", starts=("tcp://",), parse=parse_address)]
    profiles: Annotated[
        str, Key("where its profiles arrive here", starts=("udp://",), parse=parse_address)
    ]
    serial: Annotated[
        int | None, Key("its serial number, so that no other's profiles are taken; absent: any")
    ] = None
    rate_hz: Annotated[float, _RATE]
    points_per_profile: Annotated[int, Key("how many at most", at_least=1)]
    set_rate: Annotated[bool, Key("true: rate_hz is written to the sensor")] = False
    exposure_us: Annotated[
        float | None, Key("written to the sensor; absent: as it is", at_least=3.0, at_most=3e5)
    ] = None
    trigger: Annotated[
        RiftekTrigger, Key("sensor: by itself; software: asked for each profile")
    ] = RiftekTrigger.SENSOR
    x_offset_mm: Annotated[float, Key("added to the sensor's x")] = 0.0
    z_offset_mm: Annotated[float, Key("added to the sensor's z: where its range begins")] = 0.0

    def __post_init__(self) -> None:
        if self.set_rate and not self.rate_hz.is_integer():
            raise ValueError(
                f"rate_hz: {self.rate_hz}; the sensor takes whole numbers, or set_rate = false"
            )
        self.driver_settings  # noqa: B018 (refuses what the sensor would)

    @property
    def driver_settings(self) -> riftek.Settings:
        """What the driver must know; ValueError where it cannot be."""
        software = self.trigger is RiftekTrigger.SOFTWARE
        return riftek.Settings(
            x_offset_mm=self.x_offset_mm,
            z_offset_mm=self.z_offset_mm,
            rate_hz=int(self.rate_hz) if self.set_rate else None,
            exposure_us=self.exposure_us,
            sync=riftek.Sync.SOFTWARE if software else riftek.Sync.INTERNAL,
            serial=self.serial,
        )


class HokuyoPort(Enum):
    """Whether the address's baud rate means anything."""

    RS_232 = "rs-232"
    USB = "usb"  # or a network: bytes take no time worth counting


@dataclass(frozen=True, slots=True, kw_only=True)
class Hokuyo:
    """A Hokuyo scanner in SCIP 2.0: which of its steps are a profile."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "hokuyo"
    address: Annotated[
        str,
        Key(
            "the scanner's port; its laser's switch is on it, too",
            starts=("serial://", "tcp://"),
            parse=parse_address,
        ),
    ]
    port: Annotated[HokuyoPort, Key("rs-232, or usb: then the baud rate has no meaning")] = (
        HokuyoPort.RS_232
    )
    first_step: Annotated[int, Key("of the profile, from 0", at_least=0, at_most=9999)]
    last_step: Annotated[int, Key("of the profile", at_least=0, at_most=9999)]
    cluster: Annotated[
        int, Key("so many neighbours become one, the nearest of them", at_least=1, at_most=99)
    ] = 1
    rate_hz: Annotated[float, Key("turns a second, as its data sheet has them", above=0.0)] = 10.0
    serial: Annotated[str, Key("its serial number, so that no other is taken; empty: any")] = ""
    firmware: Annotated[str, Key("its firmware must begin so; empty: any")] = ""

    def __post_init__(self) -> None:
        if self.first_step > self.last_step:
            raise ValueError(
                f"first_step: {self.first_step} is above last_step {self.last_step}; swap them"
            )
        try:
            self.driver_settings  # noqa: B018 (refuses what the driver would)
        except ValueError as slow:
            raise ValueError(f'{slow}; or write port = "usb" where it is on USB') from slow

    @property
    def driver_settings(self) -> hokuyo.Settings:
        """What the driver must know; ValueError where a switch-off would be confirmed too late."""
        place = parse_address(self.address)
        slow = isinstance(place, SerialAddress) and self.port is HokuyoPort.RS_232
        return hokuyo.Settings(
            first_step=self.first_step,
            last_step=self.last_step,
            cluster=self.cluster,
            baud=place.baud if slow and isinstance(place, SerialAddress) else None,
            serial=self.serial,
            firmware=self.firmware,
        )

    @property
    def points_per_profile(self) -> int:
        """How many ranges the steps give."""
        return self.driver_settings.window.points


class SickByteOrder(Enum):
    """How a word of its memory is sent."""

    BIG = "high byte first"
    LITTLE = "low byte first"


class SickAddresses(Enum):
    """What an address of its memory counts."""

    WORDS = "words"
    BYTES = "bytes"


@dataclass(frozen=True, slots=True, kw_only=True)
class SickProfiler2:
    """A SICK Profiler 2 on RS-485: whole profiles by reads of its memory."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "sick"
    address: Annotated[
        str,
        Key("its port, which it shares with nobody", starts=("serial://",), parse=parse_address),
    ]
    points: Annotated[int, Key("of a whole profile; it must say so many", at_least=1, at_most=2047)]
    thinning: Annotated[int, Key("every so many-th is read", at_least=1, at_most=15)] = 1
    x_mm_per_count: Annotated[float, Key("scale of the sensor's x integers", above=0.0)]
    z_mm_per_count: Annotated[float, Key("scale of its z; below 0 where z falls")]
    x_offset_mm: Annotated[float, Key("added to x after scaling")] = 0.0
    z_offset_mm: Annotated[float, Key("added to z after scaling")] = 0.0
    byte_order: Annotated[SickByteOrder, Key("high byte first, or low byte first")] = (
        SickByteOrder.BIG
    )
    addresses: Annotated[SickAddresses, Key("words or bytes: what a memory address counts")] = (
        SickAddresses.WORDS
    )

    def __post_init__(self) -> None:
        self.driver_settings  # noqa: B018 (refuses what the driver would)

    @property
    def driver_settings(self) -> sick.Settings:
        """What the driver must know; ValueError where it cannot be."""
        return sick.Settings(
            x_mm_per_count=self.x_mm_per_count,
            z_mm_per_count=self.z_mm_per_count,
            x_offset_mm=self.x_offset_mm,
            z_offset_mm=self.z_offset_mm,
            byte_order=sick.ByteOrder[self.byte_order.name],
            addresses=sick.Addresses[self.addresses.name],
            points=self.points,
            thinning=self.thinning,
        )

    @property
    def baud(self) -> int:
        """Of its line."""
        place = parse_address(self.address)
        assert isinstance(place, SerialAddress)
        return place.baud

    @property
    def points_per_profile(self) -> int:
        """How many of its points are read."""
        return -(-self.points // self.thinning)

    @property
    def rate_hz(self) -> float:
        """Profiles a second, as many as its line can carry."""
        return 1.0 / sick.reading_s(self.points_per_profile, self.baud)
