"""``loftscan devices``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import Debug, JsonLines
from loftscan.commands.running import fail, run

if TYPE_CHECKING:
    from loftscan.surveying import Finding

_INDENT = " " * 10


def devices(
    station: Annotated[
        Path | None, typer.Argument(metavar="[STATION.toml]", help="Ask its devices, too.")
    ] = None,
    times: Annotated[
        int, typer.Option(min=1, help="Ask each so often: counters tell a bad cable.")
    ] = 1,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Say what is there, who holds it, and how to fix the rest."""

    def work() -> None:
        if station is None:
            _tell_machine(json_lines=json_lines)
        else:
            _tell_station(station, times, json_lines=json_lines)

    run(work, debug=debug)


def _tell_machine(*, json_lines: bool) -> None:
    from loftscan.machine import checks, ports

    found_ports, found_checks = ports(), checks()
    if json_lines:
        for port in found_ports:
            print(json.dumps({"event": "port", "ok": not port.trouble, **asdict(port)}))
        for check in found_checks:
            print(json.dumps({"event": "check", "ok": not check.trouble, **asdict(check)}))
        return
    if not found_ports:
        print("no serial port found; is the cable in?")
    for port in found_ports:
        named = " ".join(each for each in (port.description, port.serial) if each and each != "n/a")
        print(f"{port.device}  {named}".rstrip() + f": {port.trouble or 'free'}")
    for check in found_checks:
        print(f"{check.what}: {check.trouble or 'ok'}")


def _tell_station(station: Path, times: int, *, json_lines: bool) -> None:
    from acquisition.errors import Stopped
    from acquisition.scan import StopRequest, Wish
    from loftscan.signals import ENDING, heeding
    from loftscan.station_files import station_of
    from loftscan.surveying import survey

    settings, stop = station_of(station), StopRequest()
    with heeding(dict.fromkeys(ENDING, stop.now)):
        findings = survey(settings, times=times)
    for each in findings:
        print(json.dumps(_as_json(each)) if json_lines else _in_words(each), flush=True)
    if stop.wish is not Wish.GO_ON:
        raise Stopped("stopped by the operator; nothing was changed")
    if silent := [each.role for each in findings if each.trouble]:
        fail(
            4,
            f"{station}: of {len(findings)} devices {len(silent)} "
            f"{'is' if len(silent) == 1 else 'are'} not ready ({', '.join(silent)});"
            " the lines above say why and what to do",
        )


def _as_json(found: Finding) -> dict[str, object]:
    state, promise = found.state, found.guarantee
    return {
        "event": "device",
        "ok": not found.trouble,
        "role": found.role,
        "family": found.family,
        "addresses": found.addresses,
        "tier": found.tier,
        "identity": None if found.identity is None else asdict(found.identity),
        "position": found.position or None,
        "homed": None if state is None else state.homed,
        "alarm": None if state is None else state.alarm,
        "laser_off_within_ms": None if promise is None else _watchdog_ms(promise.watchdog_s),
        "guarantee": None if promise is None else promise.sentence,
        "counters": dict(found.counters),
        "advice": found.advice,
        "trouble": found.trouble,
    }


def _in_words(found: Finding) -> str:
    lines = [f"{found.role:<10}{found.family} {' '.join(found.addresses)}".rstrip()]
    if found.identity is not None:
        who = found.identity
        told = (who.family, who.model, who.firmware, who.serial and f"serial {who.serial}")
        lines.append(f"{_INDENT}{', '.join(each for each in told if each)}")
    if found.state is not None:
        homed = "homed" if found.state.homed else "not homed"
        where = f" at {found.position}" if found.position else ""
        lines.append(f"{_INDENT}{found.state.motion.value}{where}, {homed}")
    if found.guarantee is not None:
        within_ms = _watchdog_ms(found.guarantee.watchdog_s)
        promise = "no guarantee" if within_ms is None else f"guaranteed: {within_ms} ms"
        lines.append(f"{_INDENT}{found.guarantee.sentence} ({promise})")
    if found.tier:
        lines.append(f"{_INDENT}protocol checked: {found.tier}")
    if found.counters:
        counted = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in found.counters.items())
        lines.append(f"{_INDENT}line: {counted}")
    lines.append(f"{_INDENT}{found.trouble or found.advice or 'ok'}")
    return "\n".join(lines)


def _watchdog_ms(watchdog_s: float | None) -> int | None:
    return None if watchdog_s is None else round(1000.0 * watchdog_s)
