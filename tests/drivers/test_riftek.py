"""RIFTEK RF62X: datagrams by hand and captured, losses, and HTTP to a server of the test's."""

from __future__ import annotations

import json
import os
import struct
from collections import deque
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.profiler import Profile, Reason, Tally
from drivers.riftek import Loss, Riftek, Settings, Sync, WebApi
from drivers.riftek.web import Connection, parsed
from drivers.riftek.wire import Gap, Pixels, ProfileMessage, Stream, decode

DATA = Path(os.environ.get("LOFTSCAN_DATA", Path(__file__).resolve().parents[3] / "shared/data"))

# By hand from the layout of RF627protocol.c and RFProfile.V1.js, not by a codec of ours: x range
# 166 mm, z range 200 mm, over 16384; three points (-100, 1000), (0, 0), (8192, 16384).
HEAD = (
    "11 01 7302 20BF0200 00CA9A3B00000000 01 00 30 40"
    "{packet} {measure} C800 A600 0040 000000000000000000000000 0000"
)
STATE = "E0930400 2A000000 09000000 01 0C00 04"
POINTS = "9CFF E803  0000 0000  0020 0040"
SHADES = "07 00 FF"


def golden(packet: int = 5, measure: int = 5, points: str = POINTS + SHADES) -> bytes:
    numbers = {name: struct.pack("<I", n).hex() for name, n in
               (("packet", packet), ("measure", measure))}  # fmt: skip
    return bytes.fromhex((HEAD.format(**numbers) + STATE + points).replace(" ", ""))


def patched(at: int, data: bytes, of: bytes | None = None) -> bytes:
    whole = golden() if of is None else of
    return whole[:at] + data + whole[at + len(data) :]


# -- datagrams -------------------------------------------------------------------------------------


def test_the_golden_frame_is_read_as_it_was_laid_out() -> None:
    assert len(golden()) == 64 + 3 * 4 + 3
    message = decode(golden())
    assert isinstance(message, ProfileMessage)
    assert (message.packet, message.measure, message.serial) == (5, 5, 180_000)
    assert (message.device_type, message.system_time) == (627, 1_000_000_000)
    assert (message.step, message.exposure) == (9, 300_000)
    assert message.x.tolist() == [-100, 0, 8192]
    assert message.z.tolist() == [1000, 0, 16_384]
    assert message.intensity.tolist() == [7, 0, 255]
    assert message.x_scale_mm == 166 / 16_384
    assert message.z_scale_mm == 200 / 16_384


def test_a_profile_by_polynomial_has_one_scale_for_both() -> None:
    polynomial = patched(32, struct.pack("<f", 0.0125), patched(0, b"\x20"))
    message = decode(polynomial)
    assert isinstance(message, ProfileMessage)
    assert message.x_scale_mm == message.z_scale_mm == pytest.approx(0.0125, rel=1e-7)


def test_without_its_flag_there_is_no_intensity_and_pixels_are_no_profile() -> None:
    plain = decode(patched(1, b"\x00", golden(points=POINTS)))
    assert isinstance(plain, ProfileMessage)
    assert len(plain.intensity) == 0
    for kind in (b"\x10", b"\x12"):
        assert decode(patched(0, kind)) == Pixels(packet=5)


@pytest.mark.parametrize(
    ("datagram", "says"),
    [
        (b"", "0 B"),
        (golden()[:63], "63 B; its state ends at 64"),
        (golden()[:-1], "its 3 points end at 79"),
        (patched(0, b"\x30"), "data type 0x30"),
        (patched(16, b"\x02"), "protocol 2.0; 1.x is known"),
        (patched(32, b"\0\0"), "over 0"),
        (patched(28, b"\0\0"), "ranges of 166 and 0 mm"),
        (patched(61, struct.pack("<H", 13)), "13 B of points, 4 B each"),
        (patched(63, b"\x02"), "2 B each; 4 are known"),
        (patched(19, b"\x05"), "its 3 points end at"),
        (patched(32, struct.pack("<f", float("nan")), patched(0, b"\x20")), "a scale of nan"),
    ],
)
def test_a_datagram_that_breaks_the_layout_is_a_frame_error(datagram, says) -> None:
    with pytest.raises(FrameError) as wrong:
        decode(datagram)
    assert says in str(wrong.value)


@given(st.binary(max_size=200), st.integers(0, 79), st.integers(0, 255))
def test_whatever_arrives_the_stream_raises_nothing(noise, at, byte) -> None:
    stream = Stream()
    for datagram in (noise, patched(at, bytes([byte])), golden()[:at], golden()):
        assert len(list(stream.feed(datagram))) <= 2


@pytest.mark.parametrize("number", [0, 5, 9])
def test_captured_datagrams_of_a_real_sensor_decode_to_what_the_vendors_code_gives(number) -> None:
    path = DATA / f"riftek/Profile_{number}.bin"
    if not path.exists():
        pytest.skip("no captured datagrams: set LOFTSCAN_DATA")
    datagram = path.read_bytes()
    message = decode(datagram)
    assert isinstance(message, ProfileMessage)
    # Of all three, by the vendor's own unpacker: 648 points, ZMR 200, XEMR 166, protocol 1.0.
    assert (len(datagram), len(message.x), message.device_type) == (2656, 648, 627)
    assert message.x_scale_mm * 16_384 == pytest.approx(166.0)
    assert message.z_scale_mm * 16_384 == pytest.approx(200.0)
    assert (message.measure, message.serial, len(message.intensity)) == (number, 180_000, 0)
    if number == 0:
        x_mm, z_mm = message.x * message.x_scale_mm, message.z * message.z_scale_mm
        assert (round(x_mm.min(), 2), round(x_mm.max(), 2)) == (-38.76, 37.86)
        assert (z_mm.min(), round(z_mm.max(), 2)) == (0.0, 90.88)


# -- losses ----------------------------------------------------------------------------------------


def fed(*numbers: tuple[int, int]) -> tuple[list[object], Stream]:
    stream = Stream()
    told: list[object] = []
    for packet, measure in numbers:
        for event in stream.feed(golden(packet, measure)):
            told.append(event.packet if isinstance(event, ProfileMessage) else event)
    return told, stream


def test_packet_counts_that_never_came_are_lost_and_measures_without_one_were_not_sent() -> None:
    assert fed((13, 20), (14, 21), (19, 26))[0] == [13, 14, Gap(4, 0), 19]
    assert fed((13, 20), (14, 23))[0] == [13, Gap(0, 2), 14]
    assert fed((13, 20), (16, 25))[0] == [13, Gap(2, 2), 16]


def test_the_counts_wrap() -> None:
    top = 2**32 - 1
    assert fed((top, top), (0, 0), (2, 2))[0] == [top, 0, Gap(1, 0), 2]


def test_what_comes_twice_or_late_is_ignored_until_it_marches_on() -> None:
    told, stream = fed((9, 9), (9, 9), (8, 8), (10, 10))
    assert told == [9, 10]
    assert stream.ignored == 2
    told, stream = fed((40, 40), *((n, n) for n in range(1, 12)))
    assert told == [40, *range(8, 12)]


def test_a_sensor_that_restarted_is_no_loss() -> None:
    told, stream = fed((1_761_460_697, 3), (1, 0), (2, 1))
    assert told == [1_761_460_697, 1, 2]
    assert stream.restarts == 1


def test_a_stand_in_that_counts_measures_alone_is_followed_by_them() -> None:
    # As Pallob-Gain's emulator does, which sends one captured packet count for ever.
    told, _ = fed((7, 1), (7, 2), (7, 5))
    assert told == [7, 7, Gap(2, 0), 7]


# -- the profiler ----------------------------------------------------------------------------------


class Time:
    def __init__(self) -> None:
        self.now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


class Line:
    """A link that says what it was given; None is a silence of one read, as is its end."""

    def __init__(self, time: Time, said: Sequence[bytes | None], address: str) -> None:
        self.time, self.said, self.address = time, deque(said), address
        self.wrote: list[bytes] = []
        self.ends = False  # the peer closes when it has said all
        self.closed = False

    def read(self, timeout_s: float) -> bytes:
        if not self.said and self.ends:
            raise LinkLost(f"{self.address}: the peer closed")
        data = self.said.popleft() if self.said else None
        if data is None:
            self.time.now_s += max(timeout_s, 0.0)
            return b""
        return data

    def write(self, data: bytes) -> None:
        self.wrote.append(data)

    def close(self) -> None:
        self.closed = True


class Web:
    """Connections to an HTTP server that gives its answers one after the other."""

    def __init__(self, time: Time, *answers: Sequence[bytes | None] | bytes) -> None:
        self.time, self.answers = time, deque(answers)
        self.lines: list[Line] = []
        self.ends = False

    def __call__(self) -> Line:
        answer = self.answers.popleft() if self.answers else ()
        pieces = [answer] if isinstance(answer, bytes) else answer
        line = Line(self.time, pieces, "tcp://192.0.2.9:80")
        line.ends = self.ends
        self.lines.append(line)
        return line

    @property
    def asked(self) -> list[str]:
        return [line.wrote[0].decode().split("\r\n")[0] for line in self.lines]


def ok(values: object) -> bytes:
    body = json.dumps(values).encode()
    return b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(body) + body


IDENTITY = {
    "fact_general_deviceType": 627,
    "fact_general_serial": 180_000,
    "fact_general_firmwareVer": [2, 19, 3],
    "user_streams_udpEnabled": 1,
    "user_streams_format": 17,
}


def sensor(
    *datagrams: bytes | None,
    settings: Settings | None = None,
    answers: Sequence[Sequence[bytes | None] | bytes] = (),
) -> tuple[Riftek, Web, Line]:
    time = Time()
    web, line = Web(time, *answers), Line(time, datagrams, "udp://:50001")
    api = WebApi(web, "tcp://192.0.2.9:80", clock=time)
    return Riftek(api, line, settings or Settings(), clock=time), web, line


def take(profiler: Riftek, count: int = 1) -> list[Profile]:
    return list(islice(profiler.profiles(0.5), count))


def test_a_datagram_becomes_a_profile_with_its_own_scale_and_a_reason_where_z_is_0() -> None:
    riftek, _, _ = sensor(golden(), settings=Settings(x_offset_mm=1.0, z_offset_mm=75.0))
    (profile,) = take(riftek)
    assert profile.reasons.tolist() == [Reason.MEASURED, Reason.NO_RETURN, Reason.MEASURED]
    assert profile.points_mm == pytest.approx(
        np.array([[1.0 - 100 * 166 / 16_384, 75.0 + 1000 * 200 / 16_384], [84.0, 275.0]])
    )
    assert profile.intensity.tolist() == [7, 0, 255]
    assert (profile.encoder, profile.frame, profile.sensor_time_s) == (9, 5, 1.0)


def test_lost_unsent_and_bad_ones_are_counted_and_the_stream_goes_on() -> None:
    riftek, _, _ = sensor(golden(1, 1), golden(4, 6), b"noise", golden(5, 7))
    assert [profile.frame for profile in take(riftek, 3)] == [1, 4, 5]
    assert riftek.tally() == Tally(profiles=3, lost_profiles=2, bad_frames=1)
    assert riftek.loss() == Loss(profiles=3, lost=2, unsent=2, bad=1)


def test_what_a_discard_threw_away_is_no_loss() -> None:
    riftek, _, line = sensor(golden(1, 1), golden(2, 2))
    riftek.discard()
    line.said.append(golden(9, 9))
    assert [profile.frame for profile in take(riftek)] == [9]
    assert riftek.tally() == Tally(profiles=1)


@pytest.mark.parametrize(
    ("datagram", "settings", "says"),
    [
        (None, Settings(), "is the laser on, the trigger running"),
        (patched(0, b"\x10"), Settings(), "only lines in pixels"),
        (b"?", Settings(), "no profile of it"),
        (golden(), Settings(serial=1), "only another sensor's"),
    ],
)
def test_a_silence_says_what_came_instead(datagram, settings, says) -> None:
    riftek, _, _ = sensor(datagram, settings=settings)
    with pytest.raises(NoReply, match=says):
        take(riftek)


def test_identify_names_the_sensor_and_refuses_others_and_streams_of_no_use() -> None:
    riftek, web, _ = sensor(answers=[ok(IDENTITY)])
    who = riftek.identify()
    assert (who.family, who.model, who.firmware, who.serial) == (
        "riftek", "RF627", "2.19.3", "180000",
    )  # fmt: skip
    assert web.asked[0].startswith(
        "GET /api/v1/config/params/values?name=fact_general_deviceType&name=fact_general_serial"
    )
    assert web.lines[0].closed
    for change, says in (
        ({"fact_general_deviceType": 42}, "device type 42, not an RF62X"),
        ({"user_streams_udpEnabled": 0}, "its UDP stream is off"),
        ({"user_streams_format": 16}, "it streams pixels"),
    ):
        riftek, _, _ = sensor(answers=[ok(IDENTITY | change)])
        with pytest.raises(Refused, match=says):
            riftek.identify()


def test_set_up_writes_rate_exposure_and_sync_in_the_sensors_units_and_reads_back() -> None:
    told = Settings(rate_hz=100, exposure_us=250.04, sync=Sync.SOFTWARE)
    kept = {
        "user_sensor_framerate": 100,
        "user_sensor_exposure1": 250_000,
        "user_sensor_syncSource": 2,
    }
    done = dict.fromkeys(kept, "RF_OK")
    riftek, web, _ = sensor(settings=told, answers=[ok(done), ok(kept)])
    riftek.set_up()
    assert web.asked[0] == (
        "PUT /api/v1/config/params/values?user_sensor_framerate=100&user_sensor_exposure1=250000"
        "&user_sensor_syncSource=2 HTTP/1.1"
    )
    for answers, says in (
        ([ok(done | {"user_sensor_framerate": "RF_OUT_OF_BOUNDS"})], "= 100: RF_OUT_OF_BOUNDS"),
        ([ok({})], "user_sensor_framerate = 100: not mentioned"),
        ([ok(done), ok(kept | {"user_sensor_exposure1": 3000})], "reads back as 3000 after 250000"),
    ):
        riftek, _, _ = sensor(settings=told, answers=answers)
        with pytest.raises(Refused, match=says):
            riftek.set_up()
    untouched, web, _ = sensor()
    untouched.set_up()
    assert web.asked == []


def test_a_software_trigger_is_asked_for_once_a_profile() -> None:
    riftek, web, line = sensor(
        golden(1, 1), settings=Settings(sync=Sync.SOFTWARE), answers=[ok({})] * 3
    )
    take(riftek)
    with pytest.raises(NoReply):
        take(riftek)
    with pytest.raises(NoReply):
        take(riftek)
    assert web.asked == ["GET /api/v1/profile/capture?count=1 HTTP/1.1"] * 2
    riftek.discard()
    line.said.append(golden(2, 2))
    take(riftek)
    assert len(web.asked) == 3


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"rate_hz": 0}, "rate_hz: 0; the sensor takes whole numbers from 1 to 20000"),
        ({"rate_hz": 20_001}, "rate_hz: 20001"),
        ({"exposure_us": 2.9}, "exposure_us: 2.9; write a number from 3 to 300000"),
        ({"exposure_us": float("nan")}, "exposure_us: nan"),
        ({"z_offset_mm": float("inf")}, "z_offset_mm = inf; write a finite number"),
    ],
)
def test_settings_beyond_the_sensors_bounds_are_refused(settings, says) -> None:
    with pytest.raises(ValueError, match=says):
        Settings(**settings)


# -- HTTP ------------------------------------------------------------------------------------------


def test_an_answer_in_any_pieces_chunks_or_ended_by_closing_is_read() -> None:
    sized = ok({"a": 1})
    chunked = (
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
        b'4;x=y\r\n{"a"\r\n3\r\n: 1\r\n1\r\n}\r\n0\r\n\r\n'
    )
    for whole in (sized, chunked):
        for end in range(len(whole)):
            assert parsed(whole[:end], Connection.OPEN) is None or end > len(whole) - 3
        assert parsed(whole, Connection.OPEN) in ((200, b'{"a": 1}'), (200, b'{"a": 1}'))
    time = Time()
    web = Web(time, [b'HTTP/1.0 200 OK\r\n\r\n{"a"', b": 1}"])
    web.ends = True
    assert WebApi(web, "tcp://h:80", clock=time).values(["a"]) == {"a": 1}


@pytest.mark.parametrize(
    ("answer", "error", "says"),
    [
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n", Refused, "HTTP status 404"),
        (b"SSH-2.0-dropbear\r\n\r\n\r\n", FrameError, "no HTTP answer"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: x\r\n\r\n", FrameError, "no HTTP head"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n[]", FrameError, "no parameters"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\n<ht>", FrameError, "no JSON"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\n{", FrameError, "no HTTP answer"),
        ((), NoReply, "no answer in 1 s; is it powered"),
    ],
)
def test_an_answer_that_is_none_says_so_in_one_line(answer, error, says) -> None:
    time = Time()
    web = Web(time, answer)
    with pytest.raises(error, match=says) as wrong:
        WebApi(web, "tcp://h:80", clock=time).values(["a"])
    assert "\n" not in str(wrong.value)
    assert web.lines[0].closed
