"""station.toml is understood, or refused in one line that says what to write."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.settings import as_table, read_table
from acquisition.station import (
    NoLaserSwitch,
    OutputBy,
    RelayFamily,
    RelayLaser,
    Station,
    parse_station,
    read_station,
    write_station,
)
from tests.acquisition.scan_cases import STATION

TEXT = write_station(STATION)


def test_a_written_station_parses_back_to_the_same_values() -> None:
    assert parse_station(TEXT) == STATION


numbers = st.floats(1e-9, 1e9)


@settings(max_examples=50, deadline=None)
@given(
    name=st.text(st.characters(codec="utf-8")),
    speed=numbers,
    lead=numbers,
    height=st.floats(-1e300, 1e300),
    setup=st.none() | st.integers(-5, 5),
    laser=st.sampled_from(
        [
            NoLaserSwitch(),
            RelayLaser(family=RelayFamily.PLAIN, address="tcp://h:1"),
            replace(STATION.laser, output_by=OutputBy.REGISTER_BIT, output=15),  # type: ignore[type-var]
        ]
    ),
)
def test_whatever_a_station_holds_comes_back(
    name: str, speed: float, lead: float, height: float, setup: int | None, laser: RelayLaser
) -> None:
    station = replace(
        STATION,
        name=name,
        table=replace(STATION.table, speed_deg_s=speed),
        stage=replace(STATION.stage, screw_lead_mm=lead),
        profiler=replace(STATION.profiler, setup=setup),
        kinematics=replace(STATION.kinematics, height_mm=height),
        laser=laser,
    )
    assert parse_station(write_station(station)) == station
    assert read_table(Station, as_table(station), "scan.json") == station


def test_every_key_of_a_written_station_is_explained_and_carries_its_unit() -> None:
    keys = [line for line in TEXT.splitlines() if re.match(r"(# )?\w+ = ?", line)]
    assert len(keys) > 40
    without = [line for line in keys if "  # " not in line and not re.match("family|switch", line)]
    assert without == []
    floats = re.findall(r"^(\w+) = -?[\d.e+-]*\.[\d.e+-]*  #", TEXT, re.MULTILINE)
    unit = re.compile(r"_(mm|deg|s|hz|mm_s|deg_s|per_deg|per_count|days|percent)$")
    assert [key for key in floats if not unit.search(key)] == []


def edited(pattern: str, instead: str) -> str:
    text, count = re.subn(pattern, instead, TEXT, flags=re.MULTILINE)
    assert count == 1, pattern
    return text


@pytest.mark.parametrize(
    ("pattern", "instead", "said"),
    [
        (
            "^screw_lead_mm",
            "screw_leed_mm",
            "stage.screw_leed_mm: unknown key; did you mean stage.screw_lead_mm?",
        ),
        (
            "^screw_lead_mm",
            "screw_lead",
            "stage.screw_lead: the unit is missing; write stage.screw_lead_mm",
        ),
        (
            "^standoff_mm",
            "standoff",
            "kinematics.standoff: the unit is missing; write kinematics.standoff_mm",
        ),
        ("^screw_lead_mm.*\n", "", "stage.screw_lead_mm is missing; add screw_lead_mm = ..."),
        (
            "^screw_lead_mm = 5.0",
            'screw_lead_mm = "5 mm"',
            "stage.screw_lead_mm: '5 mm' is of the wrong type; write a num",
        ),
        (
            "^screw_lead_mm = 5.0",
            "screw_lead_mm = true",
            "stage.screw_lead_mm: True is of the wrong type",
        ),
        (
            "^screw_lead_mm = 5.0",
            "screw_lead_mm = -5.0",
            "stage.screw_lead_mm: -5.0 is out of bounds; write a number above 0",
        ),
        (
            "^screw_lead_mm = 5.0",
            "screw_lead_mm = nan",
            "stage.screw_lead_mm: nan is out of bounds",
        ),
        (
            "^height_mm = 12.5",
            "height_mm = inf",
            "kinematics.height_mm: inf is out of bounds; write a finite number",
        ),
        (
            "^pulses_per_turn = 10000",
            "pulses_per_turn = 10000.0",
            "stage.pulses_per_turn: 10000.0 is of the wrong type; write a whole",
        ),
        (
            "^pulses_per_turn = 10000",
            "pulses_per_turn = 100",
            "write a number at least 200 and at most 51200",
        ),
        (
            "^lowest_mm = 0.0",
            "lowest_mm = 400.0",
            "stage.lowest_mm: 400.0 is not below highest_mm 300.0; swap them",
        ),
        (
            "^lowest_deg = -10.0",
            "lowest_deg = 400.0",
            "table.lowest_deg: 400.0 is not below highest_deg 370.0",
        ),
        (
            '^table_sense = "counter-clockwise"',
            'table_sense = "ccw"',
            'kinematics.table_sense: \'ccw\' is not known; write "counter-clockwise" or "clock',
        ),
        (
            '^family = "grbl"',
            'family = "gbrl"',
            "table.family: 'gbrl' is not known; write \"grbl\"",
        ),
        ('^family = "grbl"\n', "", 'table.family is missing; write family = "grbl"'),
        (
            '^switch = "relay"',
            'switch = "lamp"',
            'laser.switch: \'lamp\' is not known; write "relay" or "grbl" or "hokuyo" or "none"',
        ),
        ('^switch = "relay"', 'switch = "none"', "laser.family: unknown key; remove it"),
        (
            '^family = "turck"',
            'family = "plain"',
            "laser.watchdog_s: a plain relay has none; remove the key",
        ),
        ("^watchdog_s.*\n", "", "laser.watchdog_s is missing; add watchdog_s = 0.25"),
        (
            '^output_by = "coil"  #.*\noutput = 0',
            'output_by = "register bit"\noutput = 16',
            "laser.output: 16: a register has the bits 0 to 15",
        ),
        (
            '^address = "tcp://192.0.2.7:502"',
            'address = "192.0.2.7:502"',
            "profiler.address: '192.0.2.7:502' is no address; begin it with",
        ),
        (
            '^address = "tcp://192.0.2.7:502"',
            'address = "tcp://192.0.2.7:99999"',
            "profiler.address: address 'tcp://192.0.2.7:99999': Port out of range 0-65535;"
            " expected tcp://host:port",
        ),
        (r"^\[kinematics\]", "[kinematic]", "kinematic: unknown key; did you mean kinematics?"),
        ("^name", "[nonsense]\nname", "nonsense: unknown key"),
        (r"^\[table\]", "[table", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named_with_file_key_and_fix(
    pattern: str, instead: str, said: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(said)) as refused:
        parse_station(edited(pattern, instead), "bench.toml")
    assert str(refused.value).startswith("bench.toml: ")
    assert "\n" not in str(refused.value)


def test_zero_is_not_above_zero() -> None:
    with pytest.raises(ValueError, match=re.escape("stage.screw_lead_mm: 0.0 is out of bounds")):
        parse_station(edited("^screw_lead_mm = 5.0", "screw_lead_mm = 0.0"))


def test_true_is_no_whole_number() -> None:
    with pytest.raises(ValueError, match=re.escape("stage.device_id: True is of the wrong type")):
        parse_station(edited("^device_id = 1  # the drive's", "device_id = true  #"))


def test_control_characters_in_a_name_are_escaped() -> None:
    station = replace(STATION, name='a\x7f\x00\n\t"\\ü𝄞')
    assert parse_station(write_station(station)) == station


def test_a_missing_table_is_asked_for() -> None:
    text = TEXT[: TEXT.index("[kinematics]")]
    with pytest.raises(ValueError, match=re.escape("kinematics is missing; add a [kinematics] ta")):
        parse_station(text)


def test_a_table_that_is_a_number_is_refused() -> None:
    text = "kinematics = 3\n" + TEXT[: TEXT.index("[kinematics]")]
    with pytest.raises(ValueError, match=re.escape("write [kinematics] above its keys")):
        parse_station(text)


def test_whole_numbers_stand_for_lengths() -> None:
    station = parse_station(edited("^screw_lead_mm = 5.0", "screw_lead_mm = 5"))
    assert station == STATION
    assert isinstance(station.stage.screw_lead_mm, float)


def test_keys_with_a_default_may_be_left_out() -> None:
    assert parse_station(edited("^tolerance_mm = .*\n", "")) == STATION


def test_a_station_that_its_file_may_not_hold_is_not_written() -> None:
    bad = replace(STATION, table=replace(STATION.table, speed_deg_s=-1.0))
    with pytest.raises(ValueError, match=r"table\.speed_deg_s: -1\.0 is out of bounds"):
        write_station(bad)


def test_a_file_is_read_and_named(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(TEXT, encoding="utf-8")
    assert read_station(file) == STATION
    file.write_bytes(b"name = '\xff'")
    with pytest.raises(ValueError, match=r"bench\.toml: not UTF-8"):
        read_station(file)
