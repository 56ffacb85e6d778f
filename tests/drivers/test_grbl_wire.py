"""Grbl's lines: golden ones of the firmware's documents, and round trips in any chunking."""

from __future__ import annotations

import itertools
import math
import string
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.grbl.messages import (
    Alarm,
    Banner,
    Error,
    Feedback,
    Message,
    Ok,
    Setting,
    StartupLine,
    State,
    Status,
    Unknown,
    alarm_name,
    error_name,
    message_bytes,
    message_line,
    parsed,
)
from drivers.grbl.wire import (
    FENCE,
    CommandDecoder,
    Dialogue,
    Line,
    LineDecoder,
    Realtime,
    feed_move,
    jog,
    line_bytes,
    number,
)

# Each line, its meaning, and where it is printed. "interface.md" is gnea/grbl@bfb67f0
# doc/markdown/interface.md, "report.c" the format strings of its grbl/report.c; "ran" marks lines
# that a firmware running on Linux (Grbl 1.1h, grblHAL) was seen to print.
GOLDEN: list[tuple[str, Message]] = [
    ("ok", Ok()),  # interface.md, Response Messages
    ("error:9", Error(9)),  # report.c, report_status_message
    ("error:53", Error(53)),  # ran: grblHAL's answer to $99=1
    ("ALARM:3", Alarm(3)),  # ran: 0x18 in motion
    ("Grbl 1.1h ['$' for help]", Banner("Grbl", "1.1h")),  # interface.md, Start Up Message
    (  # ran: grblHAL Simulator
        "GrblHAL 1.1f ['$' or '$HELP' for help]",
        Banner("GrblHAL", "1.1f", "'$' or '$HELP' for help"),
    ),
    ("[MSG:Reset to continue]", Feedback("MSG", "Reset to continue")),  # interface.md, Feedback
    ("[MSG:'$H'|'$X' to unlock]", Feedback("MSG", "'$H'|'$X' to unlock")),  # report.c
    ("[MSG:Caution: Unlocked]", Feedback("MSG", "Caution: Unlocked")),  # interface.md, Feedback
    (  # interface.md, $G
        "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0.0 S0]",
        Feedback("GC", "G0 G54 G17 G21 G90 G94 M5 M9 T0 F0.0 S0"),
    ),
    ("[OPT:V,15,128]", Feedback("OPT", "V,15,128")),  # ran: $I of Grbl 1.1h
    ("[OPT:VNML+,100,1024,4,0]", Feedback("OPT", "VNML+,100,1024,4,0")),  # ran: $I of grblHAL
    ("[AXS:4:XYZA]", Feedback("AXS", "4:XYZA")),  # ran: grblHAL with four axes
    ("[VER:v1.1f.20170131:Some string]", Feedback("VER", "v1.1f.20170131:Some string")),  # $I
    ("[PRB:0.000,0.000,0.000:0]", Feedback("PRB", "0.000,0.000,0.000:0")),  # interface.md, $#
    ("[HOME:-10,-10,-10,0:7]", Feedback("HOME", "-10,-10,-10,0:7")),  # ran: grblHAL after $H
    ("$100=250.000", Setting(100, "250.000")),  # interface.md, $$
    (">G54G20:ok", StartupLine("G54G20")),  # interface.md, Startup Line Execution
    (">:error:7", StartupLine("", 7)),  # interface.md, an EEPROM read error at start
    (  # report.c, with $10=3 and all that is intermittent
        "<Hold:1|MPos:0.000,-10.000,5.000|Bf:15,128|Ln:99999|FS:500,8000|Pn:XYZPDHRS"
        "|WCO:0.000,1.551,5.664|Ov:100,100,100|A:SFM>",
        Status(
            State.HOLD,
            1,
            machine=(0.0, -10.0, 5.0),
            buffer=(15, 128),
            line=99999,
            feed=500.0,
            spindle=8000.0,
            pins="XYZPDHRS",
            work_offset=(0.0, 1.551, 5.664),
            overrides=(100, 100, 100),
            accessories="SFM",
        ),
    ),
    (  # ran: grbl-sim, whose inputs read as all triggered
        "<Idle|MPos:0.000,0.000,0.000|FS:0,0|Pn:PXYZRHS>",
        Status(State.IDLE, machine=(0.0, 0.0, 0.0), feed=0.0, spindle=0.0, pins="PXYZRHS"),
    ),
    (  # interface.md, WPos and the F: form of a build without spindle
        "<Idle|WPos:-2.500,0.000,11.000|F:500>",
        Status(State.IDLE, work=(-2.5, 0.0, 11.0), feed=500.0),
    ),
    (  # a fourth number and a field of its own: grblHAL with N_AXIS=4, homed
        "<Jog|MPos:0.000,0.000,0.000,12.500|FS:600,0|H:1>",
        Status(State.JOG, machine=(0.0, 0.0, 0.0, 12.5), feed=600.0, spindle=0.0, others=("H:1",)),
    ),
]


@pytest.mark.parametrize(("line", "meaning"), GOLDEN)
def test_a_golden_line_means_what_the_documents_say(line: str, meaning: Message) -> None:
    assert parsed(line) == meaning


@pytest.mark.parametrize(("line", "meaning"), GOLDEN)
def test_a_message_is_spelled_as_the_firmware_spells_it(line: str, meaning: Message) -> None:
    assert message_bytes(meaning) == line.encode() + b"\r\n"


@pytest.mark.parametrize(
    "line",
    [
        "o",
        "okok",
        "OK",
        "ok<Idle|MPos:0.000,0.000,0.000>",  # a terminator was lost
        "error:",
        "error:-1",
        "error:\u0661",  # a digit to Python, not to Grbl
        "ALARM:x",
        "<Idle>",  # the position is always there
        "<Idle|FS:0,0>",
        "<Idle|MPos:1.000,nan,0.000>",
        "<Idle|MPos:1e3,0.000,0.000>",
        "<Idle|MPos:1_0,0.000,0.000>",
        "<Idle|MPos:0.000,,0.000>",
        "<Idle|MPos:0.0.0,0.000,0.000>",
        "<Idle|MPos:0.000|MPos:1.000>",
        "<Idle|MPos:0.000|WPos:0.000>",
        "<Idle|MPos:0.000|Bf:15>",
        "<Idle|MPos:0.000|FS:5>",
        "<Idle:|MPos:0.0O0>",
        "<Idler|MPos:0.000,0.000,0.000>",
        "<Idle|MPos:0.000,0.000,0.000",
        "[MSG:Reset to continue",
        "$x=1",
    ],
)
def test_a_damaged_line_is_unknown_and_never_half_believed(line: str) -> None:
    assert parsed(line) == Unknown(line)


coordinates = st.lists(
    st.integers(-99_999_999, 99_999_999).map(lambda n: n / 1000), min_size=1, max_size=6
).map(tuple)
words = st.text(string.ascii_letters + string.digits + " .,$'|", max_size=20)
statuses = st.builds(
    Status,
    state=st.sampled_from(State),
    substate=st.none() | st.integers(0, 9),
    machine=coordinates,
    buffer=st.none() | st.tuples(st.integers(0, 99), st.integers(0, 1024)),
    line=st.none() | st.integers(1, 9_999_999),
    feed=st.integers(0, 99_999).map(float),
    spindle=st.none() | st.integers(0, 24_000).map(float),
    pins=st.text("PXYZDHRS", max_size=4),
    work_offset=st.none() | coordinates,
    overrides=st.none() | st.tuples(*[st.integers(10, 200)] * 3),
    accessories=st.text("SFM", max_size=3),
    others=st.lists(st.sampled_from(["H:1", "SD:3.14", "P:0"]), unique=True).map(tuple),
)
messages = st.one_of(
    st.just(Ok()),
    st.builds(Error, st.integers(1, 255)),
    st.builds(Alarm, st.integers(1, 255)),
    st.builds(Setting, st.integers(0, 999), words),
    st.builds(Feedback, st.text(string.ascii_uppercase, min_size=1, max_size=4), words),
    st.builds(StartupLine, words, st.none() | st.integers(1, 255)),
    st.builds(Banner, st.sampled_from(["Grbl", "GrblHAL"]), st.sampled_from(["1.1h", "1.1f"])),
    statuses,
    statuses.map(lambda s: Status(s.state, work=s.machine, feed=s.feed)),
)


def chunks(data: bytes, cuts: Iterable[int]) -> list[bytes]:
    edges = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [data[a:b] for a, b in itertools.pairwise(edges)]


cuts = st.lists(st.integers(0, 10_000), max_size=30)


@given(st.lists(messages, max_size=8), cuts)
def test_messages_survive_any_chunking(said: list[Message], where: list[int]) -> None:
    decoder = LineDecoder()
    wire = b"".join(map(message_bytes, said))
    heard = [message for part in chunks(wire, where) for message in decoder.feed(part)]
    assert heard == said


@given(st.binary(max_size=300), messages, cuts)
def test_after_garbage_the_next_line_is_understood(
    noise: bytes, said: Message, where: list[int]
) -> None:
    decoder = LineDecoder()
    wire = noise + b"\r\n" + message_bytes(said)
    heard = [message for part in chunks(wire, where) for message in decoder.feed(part)]
    assert heard[-1] == said


def test_an_endless_line_is_bounded_and_costs_only_itself() -> None:
    decoder = LineDecoder()
    for _ in range(100):
        assert list(decoder.feed(b"\xff" * 1_000)) == []
    assert len(decoder._line) <= 1024
    assert list(decoder.feed(b"\r\nok\r\n")) == [Unknown("\xff" * 60), Ok()]


def test_a_line_as_long_as_the_bound_is_still_read() -> None:
    text = "[MSG:" + "x" * (512 - 6) + "]"
    assert list(LineDecoder().feed(text.encode() + b"\r\n")) == [parsed(text)]
    assert isinstance(parsed(text), Feedback)


# gnea/grbl doc/markdown/jogging.md: "$J=G53 Y5.0", each jog with its F; spaces may be left out.
def test_a_jog_is_spelled_in_machine_coordinates_with_its_feed() -> None:
    assert line_bytes(jog("X", -20, 300)) == b"$J=G21G53X-20F300\n"


# interface.md, error 30: "G53 requires either a G0 seek or G1 feed motion mode".
def test_a_move_is_spelled_in_machine_coordinates_with_its_feed() -> None:
    assert line_bytes(feed_move("A", 90.12345, 7200)) == b"G21G94G53G1A90.1235F7200\n"


@pytest.mark.parametrize("feed", [0.0, -1.0, 0.0001, math.nan, math.inf])
def test_a_move_without_a_feed_is_the_callers_mistake(feed: float) -> None:
    with pytest.raises(ValueError, match="grbl"):
        jog("X", 1.0, feed)
    with pytest.raises(ValueError, match="grbl"):
        feed_move("X", 1.0, feed)


# commands.md of gnea/grbl, the byte values of its lines 224 to 339.
def test_realtime_bytes_are_those_of_the_manual() -> None:
    spelled = {member.name: member.wire for member in Realtime}
    assert spelled == {
        "STATUS": b"?",
        "HOLD": b"!",
        "RESUME": b"~",
        "RESET": b"\x18",
        "DOOR": b"\x84",
        "JOG_CANCEL": b"\x85",
        "FEED_100": b"\x90",
    }


@given(st.floats(-9999, 9999))
def test_a_number_keeps_a_ten_thousandth_and_is_as_short_as_it_can_be(value: float) -> None:
    text = number(value)
    assert abs(float(text) - value) <= 0.5e-4 + 1e-12
    assert not text.startswith("-0") or float(text) < 0
    assert "." not in text or text[-1] not in "0."
    assert "e" not in text
    assert sum(map(str.isdigit, text)) <= 8


def test_a_number_never_exceeds_the_eight_digits_that_grbl_reads() -> None:
    assert number(36000.12345) == "36000.123"
    assert number(12345678.4) == "12345678"
    with pytest.raises(ValueError, match="8 digits"):
        number(123456789.0)


@pytest.mark.parametrize("line", ["X" * 80, "G1\nX1", "G1?", "!", "G1\x18", "G1\xe9"])
def test_a_line_that_grbl_would_not_take_as_one_is_not_sent(line: str) -> None:
    with pytest.raises(ValueError, match=r"grbl|ascii"):
        line_bytes(line)


def test_the_longest_line_is_seventy_nine_bytes() -> None:
    assert line_bytes("X" * 79) == b"X" * 79 + b"\n"


commands = st.one_of(
    st.text(string.ascii_uppercase + string.digits + "$=.-", min_size=1, max_size=79).map(Line),
    st.sampled_from(Realtime),
)


@given(st.lists(commands, max_size=10), cuts)
def test_the_board_hears_lines_and_bytes_in_any_chunking(
    said: list[Line | Realtime], where: list[int]
) -> None:
    decoder = CommandDecoder()
    wire = b"".join(c.wire if isinstance(c, Realtime) else line_bytes(c.text) for c in said)
    assert [c for part in chunks(wire, where) for c in decoder.feed(part)] == said


def test_a_realtime_byte_inside_a_line_is_heard_first_and_leaves_the_line_whole() -> None:
    heard = list(CommandDecoder().feed(b"G1?X1\xf0\x85\n"))
    assert heard == [Realtime.STATUS, Realtime.JOG_CANCEL, Line("G1X1")]


def test_a_reset_forgets_the_line_before_it() -> None:
    assert list(CommandDecoder().feed(b"G1X10\x18X1\n")) == [Realtime.RESET, Line("X1")]


# interface.md, error 11, and hardware trap: "\r\n" counts as two lines on Grbl 1.1h.
def test_the_board_counts_crlf_twice_and_says_when_a_line_is_too_long() -> None:
    heard = list(CommandDecoder().feed(b"$G\r\n" + b"X" * 500 + b"\n"))
    assert heard == [Line("$G"), Line(""), Line("X" * 79, overflow=True)]


# doc/csv/error_codes_en_US.csv and alarm_codes_en_US.csv of gnea/grbl.
def test_errors_and_alarms_have_names_and_keep_foreign_numbers() -> None:
    assert error_name(9) == "error:9 (locked by an alarm or a jog)"
    assert error_name(22) == "error:22 (undefined feed rate)"
    assert alarm_name(9) == "ALARM:9 (homing did not find the switch)"
    assert error_name(53) == "error:53 (setting not available)"  # grblHAL's
    assert "253" in error_name(253)
    assert "unknown" in error_name(253)
    assert "unknown" in alarm_name(117)
    known = [n for n in range(256) if "unknown" not in error_name(n)]
    grbl, hal = [*range(1, 18), *range(20, 39)], [18, 19, 39, 43, 45, 46, 50, 51, 52, 53, 55, 79]
    assert known == sorted(grbl + hal)
    assert [n for n in range(256) if "unknown" not in alarm_name(n)] == [*range(1, 13), 17, 18]


def test_pushes_are_never_counted_as_answers() -> None:
    dialogue = Dialogue()
    dialogue.send("$H")
    for line, meaning in GOLDEN:
        if not isinstance(meaning, Ok | Error | Banner):
            dialogue.feed(line.encode() + b"\r\n")
    assert dialogue.outstanding == "$H"
    dialogue.feed(b"ok\r\n")
    assert (dialogue.outstanding, dialogue.answer) == ("", Ok())


def test_a_second_line_before_the_answer_is_the_callers_mistake() -> None:
    dialogue = Dialogue()
    dialogue.send("$I")
    with pytest.raises(ValueError, match="outstanding"):
        dialogue.send("$$")


def test_after_a_lost_answer_only_the_fence_tells_late_answers_from_new_ones() -> None:
    dialogue = Dialogue()
    dialogue.send("G53G1X1F60")
    dialogue.give_up()
    with pytest.raises(ValueError, match="fence"):
        dialogue.send("$I")
    assert dialogue.send(FENCE) == b"$G\n"
    dialogue.feed(b"ok\r\n")  # the late one
    assert dialogue.outstanding == FENCE
    dialogue.feed(b"[GC:G0 G54]\r\nok\r\n")
    assert (dialogue.outstanding, dialogue.stray_answers) == ("", 1)
    assert dialogue.send("$I") == b"$I\n"


def test_an_answer_that_nobody_asked_for_is_counted_as_stray() -> None:
    dialogue = Dialogue()
    dialogue.feed(b"ok\r\nerror:9\r\n")
    assert (dialogue.stray_answers, dialogue.answer) == (2, None)


def test_a_restart_by_itself_upsets_and_one_that_was_asked_for_does_not() -> None:
    dialogue = Dialogue()
    dialogue.reset()
    dialogue.feed(b"\r\nGrbl 1.1h ['$' for help]\r\n")
    assert dialogue.upsets == 0
    dialogue.send("$I")
    dialogue.feed(b"\r\nGrbl 1.1h ['$' for help]\r\n")
    assert (dialogue.upsets, dialogue.outstanding, dialogue.answer) == (1, "", None)


@pytest.mark.parametrize("line", ["ALARM:1", "<Alarm|MPos:0.000>", "<Sleep|MPos:0.000>"])
def test_an_alarm_and_a_sleep_upset(line: str) -> None:
    dialogue = Dialogue()
    dialogue.feed(line.encode() + b"\r\n")
    assert dialogue.upsets == 1


def test_the_work_offset_is_kept_between_the_reports_that_bring_it() -> None:
    dialogue = Dialogue()
    dialogue.feed(b"<Idle|WPos:1.000|WCO:0.500>\r\n<Idle|WPos:2.000>\r\n")
    assert dialogue.work_offset == (0.5,)


def test_sizes_are_read_from_the_build_options() -> None:
    dialogue = Dialogue()
    assert dialogue.sizes is None
    dialogue.feed(b"[OPT:V,15,128]\r\n")
    assert dialogue.sizes == (15, 128)
    dialogue.feed(b"[OPT:VNML+,100,1024,4,0]\r\n")
    assert dialogue.sizes == (100, 1024)
    dialogue.feed(b"[OPT:V,15,10]\r\n")
    with pytest.raises(ValueError, match="buffer of 10"):
        dialogue.send("G53G1X100F60")


def test_the_text_of_an_unknown_line_is_kept() -> None:
    assert message_line(parsed("what?")) == "what?"
