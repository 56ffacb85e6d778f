"""``loftscan init``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import Debug
from loftscan.commands.running import run

if TYPE_CHECKING:
    from collections.abc import Callable

    from loftscan.new_station import Families, Question

Address = Annotated[str | None, typer.Option(help="serial://, tcp:// or udp:// and the place.")]
Length = Annotated[float | None, typer.Option()]
Count = Annotated[int | None, typer.Option(min=1)]


def init(
    out: Annotated[Path, typer.Option(help="The file to write; never overwritten.")] = Path(
        "station.toml"
    ),
    plan: Annotated[Path | None, typer.Option(help="Write a plan, too.")] = None,
    table: Address = None,
    stage: Address = None,
    table_family: Annotated[str, typer.Option(help="grbl, zaber or oriental.")] = "grbl",
    stage_family: Annotated[str, typer.Option(help="leadshine, zaber or oriental.")] = "leadshine",
    profiler_family: Annotated[
        str, typer.Option(help="baumer_ox, riftek, registers, banner_ez_array, hokuyo or sick.")
    ] = "baumer_ox",
    profiler: Address = None,
    profiles: Address = None,
    laser: Annotated[str | None, typer.Option(help="The relay's address, or none.")] = None,
    steps_per_deg: Length = None,
    table_speed_deg_s: Length = None,
    lowest_deg: Length = None,
    highest_deg: Length = None,
    pulses_per_turn: Count = None,
    screw_lead_mm: Length = None,
    stage_speed_mm_s: Length = None,
    lowest_mm: Length = None,
    highest_mm: Length = None,
    rate_hz: Length = None,
    points: Count = None,
    x_mm_per_count: Length = None,
    z_mm_per_count: Length = None,
    watchdog_s: Length = None,
    height_mm: Length = None,
    standoff_mm: Length = None,
    debug: Debug = False,
) -> None:
    """Write a commented station.toml for your devices.

    Asks on a terminal for what no option says; elsewhere that is marked PLACEHOLDER.
    """
    said = {
        "table.address": table,
        "table.steps_per_deg": steps_per_deg,
        "table.speed_deg_s": table_speed_deg_s,
        "table.lowest_deg": lowest_deg,
        "table.highest_deg": highest_deg,
        "stage.address": stage,
        "stage.pulses_per_turn": pulses_per_turn,
        "stage.screw_lead_mm": screw_lead_mm,
        "stage.speed_mm_s": stage_speed_mm_s,
        "stage.lowest_mm": lowest_mm,
        "stage.highest_mm": highest_mm,
        "profiler.address": profiler,
        "profiler.profiles": profiles,
        "profiler.rate_hz": rate_hz,
        "profiler.points_per_profile": points,
        "profiler.x_mm_per_count": x_mm_per_count,
        "profiler.z_mm_per_count": z_mm_per_count,
        "laser.address": laser,
        "laser.watchdog_s": watchdog_s,
        "kinematics.height_mm": height_mm,
        "kinematics.standoff_mm": standoff_mm,
    }
    answers = {k: v for k, v in said.items() if v is not None}
    families = (table_family, stage_family, profiler_family)
    run(lambda: _write(out, plan, answers, families), debug=debug)


def _write(
    out: Path, plan: Path | None, answers: dict[str, str | float | int], named: tuple[str, str, str]
) -> None:
    from acquisition.station import parse_station
    from loftscan.new_station import MARK, Families, new_plan, new_station

    families = Families(*named)
    files = [file for file in (out, plan) if file is not None]
    for file in files:
        _must_be_new(file)
    if sys.stdin.isatty():
        _ask(answers, families)
    text, to_set = new_station(answers, str(out), families)
    texts = [text, new_plan(parse_station(text, str(out)))]
    for file, written in zip(files, texts, strict=False):
        with file.open("x", encoding="utf-8") as new:
            new.write(written)
        print(f"{file}: written")
    print(
        f"to be set or checked in {out}, marked {MARK.partition(',')[0]}: {', '.join(to_set)}\n"
        f"then: loftscan devices {out}"
    )
    if plan is not None:
        print(f"{plan}: adapt its heights to the part")


def _must_be_new(file: Path) -> None:
    if file.exists() or file.is_symlink():
        raise ValueError(f"{file}: is there already and stays as it is; name another file")
    if not file.parent.is_dir():
        raise ValueError(f"{file}: there is no folder {file.parent}; make it first")


def _ask(answers: dict[str, str | float | int], families: Families) -> None:
    """Ask for what is missing; an empty answer takes what stands in brackets."""
    from loftscan.new_station import NO_SWITCH

    for question in families.questions:
        unlit = question.key.startswith("laser.") and answers.get("laser.address") == NO_SWITCH
        if question.key not in answers and not unlit:
            answers[question.key] = typer.prompt(
                question.words, default=question.placeholder, value_proc=_reader(question)
            )


def _reader(question: Question) -> Callable[[str], str | float | int]:
    def read(typed: str) -> str | float | int:
        try:
            return question.read(str(typed))
        except ValueError as wrong:
            raise typer.BadParameter(str(wrong)) from wrong

    return read
