"""calibration.toml, and which calibration a scan may use."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.calibration import (
    Calibration,
    Fit,
    deciding_keys,
    parse_calibration,
    write_calibration,
)
from acquisition.calibration_in_force import in_force
from acquisition.frames import Kind, Kinematics, Lifting, SecondStage, Turning
from acquisition.station import CalibrationSettings, Station
from tests.acquisition.scan_cases import KINEMATICS, STATION

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
WHY = "aligning the sensor, nothing is measured"
RULED = replace(STATION, kinematics=replace(KINEMATICS, kind=Kind.NOMINAL))
NAMES = ("standoff_mm", "pitch_deg", "table_deg_per_deg")


def calibration(station: Station = RULED, **changed: object) -> Calibration:
    solved = replace(
        station.kinematics, kind=Kind.CALIBRATED, pitch_deg=0.3, table_deg_per_deg=1.01,
        second_stage=SecondStage(position_mm=3.0),
    )  # fmt: skip
    return Calibration(
        kinematics=replace(solved, **changed),  # type: ignore[arg-type]
        made=NOW - timedelta(days=3),
        fit=Fit(
            artefact='balls "7"',
            artefact_sha256="00",
            software="loftscan 0",
            points=9000,
            stray=3,
            sigma_mm=0.01,
            s0=1.0,
            alike=1.0,
            rank=11,
            condition=99.0,
        ),
        names=NAMES,
        covariance=np.diag([1e-6, 1e-8, 1e-12]),
        station=deciding_keys(station),
        scans=("a.scan",),
        checks=(),
    )


def kept(folder: Path, made: Calibration, *, station: Station = RULED) -> Path:
    (folder / station.calibration.file).write_text(write_calibration(made), encoding="utf-8")
    return folder


def test_a_calibration_reads_back_as_it_was_written() -> None:
    made = calibration()
    again = parse_calibration(write_calibration(made))
    assert (again.kinematics, again.made, again.fit) == (made.kinematics, made.made, made.fit)
    assert (again.names, again.scans, again.station) == (made.names, made.scans, made.station)
    np.testing.assert_array_equal(again.covariance, made.covariance)


def test_a_scan_uses_the_calibration_that_holds(tmp_path: Path) -> None:
    held = in_force(RULED, kept(tmp_path, calibration()), NOW)
    assert held.kinematics == calibration().kinematics
    assert held.source == "calibration.toml"
    assert len(held.calibration_sha256) == 64
    assert held.override == ""


def test_a_simulated_station_needs_none(tmp_path: Path) -> None:
    assert in_force(STATION, tmp_path, NOW).kinematics == KINEMATICS


def test_no_calibration_is_refused_with_the_command_that_makes_one(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"there is no calibration .* loftscan calibrate .*override"
    ):
        in_force(RULED, tmp_path, NOW)


def test_the_operators_words_let_it_pass_and_are_kept(tmp_path: Path) -> None:
    held = in_force(RULED, tmp_path, NOW, override=WHY)
    assert held.kinematics == RULED.kinematics
    assert held.override.startswith(WHY)
    assert "there is no calibration" in held.override


@pytest.mark.parametrize("words", ["", "  ", "ok"])
def test_words_that_say_nothing_do_not(tmp_path: Path, words: str) -> None:
    with pytest.raises(ValueError, match="say why in words"):
        in_force(RULED, tmp_path, NOW, override=words)


def test_a_stale_calibration_is_refused(tmp_path: Path) -> None:
    folder = kept(tmp_path, calibration())
    with pytest.raises(ValueError, match=r"31\.0 days old, and calibration\.max_age_days is 30"):
        in_force(RULED, folder, NOW + timedelta(days=28))
    patient = replace(RULED, calibration=CalibrationSettings(max_age_days=60.0))
    assert in_force(patient, folder, NOW + timedelta(days=28)).override == ""


def test_a_calibration_of_tomorrow_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="set the clock right"):
        in_force(RULED, kept(tmp_path, calibration()), NOW - timedelta(days=30))


def test_another_stations_calibration_is_refused_and_the_key_named(tmp_path: Path) -> None:
    folder = kept(tmp_path, calibration())
    other = replace(RULED, table=replace(RULED.table, steps_per_deg=44.45))
    with pytest.raises(ValueError, match=r"table\.steps_per_deg was 88\.9, is 44\.45"):
        in_force(other, folder, NOW)
    moved = replace(RULED, kinematics=replace(RULED.kinematics, standoff_mm=160.0))
    with pytest.raises(ValueError, match=r"kinematics\.standoff_mm was 150\.0, is 160\.0"):
        in_force(moved, folder, NOW)


def test_addresses_may_change(tmp_path: Path) -> None:
    folder = kept(tmp_path, calibration())
    plugged = replace(RULED, table=replace(RULED.table, address="serial:///dev/ttyUSB9"))
    assert in_force(plugged, folder, NOW).override == ""


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"table_deg_per_deg": 0.5}, "wrong steps per revolution"),
        ({"table_sense": Turning.CLOCKWISE}, "turns the part clockwise"),
        ({"stage_z_mm": 1.2}, "the stage moves 1.2000 mm for a mm"),
        ({"stage_z_mm": -1.0}, "the other way"),
        ({"x_mm_per_mm": 2.0}, "x_mm_per_count"),
    ],
)
def test_a_scale_that_contradicts_the_station_is_refused_in_words(
    tmp_path: Path, changed: dict[str, object], words: str
) -> None:
    folder = kept(tmp_path, calibration(**changed))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"contradicts station\.toml") as refused:
        in_force(RULED, folder, NOW)
    assert words in str(refused.value)
    assert in_force(RULED, folder, NOW, override=WHY).kinematics.kind is Kind.CALIBRATED


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version = 1", "version = 2", "no calibration of version 1"),
        ('kind = "calibrated"', 'kind = "nominal"', "kinematics.kind"),
        ("s0 = 1.0", "s0 = nan", "fit.s0"),
        ("pitch_deg = 0.3", "pitch_deg = 99.0", "pitch_deg"),
        ("1e-06, 0.0", "-1e-06, 0.0", "a variance below 0"),
        ("1e-06, 0.0", "nan, 0.0", "not finite"),
        ("1e-06, 0.0", "1e-06, 5.0", "not symmetric"),
        ('["standoff_mm", ', '["nothing_mm", ', "'nothing_mm' is no number"),
        ('["standoff_mm", ', "[", "is \\(3, 3\\), not 2 by 2"),
        ("[covariance]", "[covariance_]", "covariance"),
    ],
)
def test_impossible_files_are_refused_in_a_line(old: str, new: str, words: str) -> None:
    text = write_calibration(calibration())
    assert old in text
    with pytest.raises(ValueError, match=words) as refused:
        parse_calibration(text.replace(old, new, 1))
    assert "\n" not in str(refused.value)


@given(st.data())
@settings(max_examples=300, deadline=None)
def test_a_bent_file_is_read_or_refused_in_a_line(data: st.DataObject) -> None:
    text = write_calibration(calibration())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text)))
        length = data.draw(st.integers(0, 12))
        text = text[:at] + data.draw(st.text(max_size=6)) + text[at + length :]
    try:
        found = parse_calibration(text)
    except ValueError as refused:
        words = str(refused)
        assert "calibration.toml" in words
    else:
        assert np.isfinite(found.covariance).all()


def test_the_rail_and_the_lift_survive(tmp_path: Path) -> None:
    held = in_force(RULED, kept(tmp_path, calibration()), NOW)
    assert held.kinematics.second_stage == SecondStage(position_mm=3.0)
    assert held.kinematics.stage_sense is Lifting.UP
    assert isinstance(held.kinematics, Kinematics)
