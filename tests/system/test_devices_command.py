"""``loftscan devices``: every family as a user meets it, whole and with what can be wrong.

That it changes nothing is told by the bytes that left, and by the simulator's witness.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from acquisition.safety.places import holder_at, places_of
from acquisition.station import read_station
from drivers.addresses import SerialAddress, parse_address
from drivers.links import ByteLink, open_link
from loftscan import simulate
from loftscan.simulation import Simulated
from loftscan.surveying import survey
from tests.system.command_cases import Ran, run, succeeded

PATIENCE_S = 60.0
# Every family that can be named, at least once.
STATIONS = {
    "network": {"table": "grbl", "stage": "leadshine", "profiler": "baumer_ox", "laser": "turck"},
    "scanner": {"table": "grblhal", "stage": "zaber", "profiler": "hokuyo"},
    "serial": {"table": "zaber", "stage": "oriental", "profiler": "sick", "laser": "grbl"},
    "shared": {"table": "oriental", "stage": "leadshine", "profiler": "riftek", "laser": "plain"},
    "columns": {"table": "grbl", "stage": "leadshine", "profiler": "registers", "laser": "timed"},
}
ROLES = ["laser", "table", "stage", "profiler"]


@pytest.fixture(scope="module", params=list(STATIONS))
def station(request: pytest.FixtureRequest) -> Iterator[Simulated]:
    with simulate(seed=3, scale=20.0, **STATIONS[request.param]) as simulated:
        yield simulated


def found(ran: Ran) -> dict[str, dict[str, object]]:
    """What was said of each device; a command that failed said why in one line more."""
    assert isinstance(ran.exception, SystemExit | None), repr(ran.exception)
    assert ran.stderr.count("\n") == (ran.exit_code != 0), ran.stderr
    each = {str(told["role"]): told for told in map(json.loads, ran.stdout.splitlines())}
    assert list(each) == ROLES
    for told in each.values():
        assert "\n" not in str(told["trouble"])
        assert bool(told["trouble"]) is not told["ok"]
    return each


def changed(station: Simulated, place: Path, table: str, pattern: str, instead: str) -> Path:
    """The live station.toml with one value of one table replaced."""
    text = station.station.read_text()
    head, begin, rest = text.partition(f"[{table}]")
    other, count = re.subn(pattern, instead, rest, count=1)
    assert count == 1, rest
    file = place / "changed.toml"
    file.write_text(head + begin + other)
    return file


def happened(station: Simulated) -> list[str]:
    events = map(json.loads, station.witness.read_text().splitlines())
    return [each["what"] for each in events if each["what"] != "wire"]


# -- whole stations ------------------------------------------------------------------------------


def test_each_says_who_it_is_its_tier_and_how_its_line_fared(station: Simulated) -> None:
    each = found(succeeded(run("devices", station, "--json", "--times", 3)))
    for told in each.values():
        assert told["identity"]["model"] or told["family"] == "registers"  # type: ignore[index]
        assert told["tier"]
        counters: dict[str, int] = told["counters"]  # type: ignore[assignment]
        if told["family"] != "riftek":  # HTTP counts nothing: a request is answered or refused
            assert counters["asked"] >= 3
            assert counters["timeouts"] == counters["damaged"] == 0
    assert {"dropped_frames", "torn_frames", "bad_frames"} <= set(each["profiler"]["counters"])
    if each["laser"]["family"] == "grbl":
        assert each["laser"]["tier"] == "inferred"
    words = succeeded(run("devices", station)).stdout
    assert words.count("protocol checked: ") == len(ROLES)
    assert words.count("line: ") == len(ROLES)


class Overheard:
    """A link, and all that is written on it."""

    def __init__(self, link: ByteLink, written: list[bytes]) -> None:
        self._link = link
        self._written = written
        self.address = link.address
        self.read, self.close = link.read, link.close

    def write(self, data: bytes) -> None:
        self._written.append(data)
        self._link.write(data)


ASKS = {
    "grbl": rb"\?|\$I\n|\$\$\n",
    "zaber": rb"\n?/\d+ \d+ \d+ ?(?:get [a-z.]+|warnings)?(?::[0-9A-F]{2})?\n",
    "hokuyo": rb"\n?(?:VV|PP|II);a\d{3}\n",
    "sick": rb"\x02.(?:\x40\x0b|\x00\x02).*\x03.",
    "riftek": rb"GET /.*",
    "rtu": rb".[\x01-\x04].{6}",
    "tcp": rb".{4}\x00\x06.[\x01-\x04].{4}",
}
_OWN = ("grbl", "zaber", "hokuyo", "sick", "riftek")


def test_nothing_is_written_set_lit_or_moved(station: Simulated) -> None:
    written: dict[str, list[bytes]] = {}

    def opened(address: str) -> ByteLink:
        return Overheard(open_link(address), written.setdefault(address, []))  # type: ignore[return-value]

    before = happened(station)
    told = survey(read_station(station.station), links=opened)
    assert not any(each.trouble for each in told)
    for each in told:
        address = each.addresses[0]
        serial = isinstance(parse_address(address), SerialAddress)
        asks = ASKS[each.family if each.family in _OWN else "rtu" if serial else "tcp"]
        assert written[address]
        for data in written[address]:
            assert re.fullmatch(asks, data, re.DOTALL), (each.family, data)
        assert all(not written[other] for other in each.addresses[1:])
    # The simulator saw no laser, no move and no stop; a SICK that is asked where its profile is
    # looks, in the dark.
    assert [each for each in happened(station)[len(before) :] if each != "profile"] == []


# -- what can be wrong -----------------------------------------------------------------------------


def test_a_device_that_is_silent_says_what_to_look_at(place: Path) -> None:
    """Each of the four, of every family: no power, or another device's wire."""
    for families in STATIONS.values():
        faults = ["silent-table", "silent-stage", "silent-profiler", "silent-relay"]
        with simulate(seed=3, scale=20.0, faults=faults, **families) as station:
            ran = run("devices", station, "--json")
            assert ran.exit_code == 4
            for told in found(ran).values():
                trouble = str(told["trouble"])
                assert re.search(r"\bno (?:answer|reply|report)\b", trouble), trouble
                assert re.search(r"; is (?:it|the)\b.*\b(?:on|powered)\b.*\?$", trouble), trouble
                assert re.search(r"(?:serial|tcp)://", trouble), trouble
            assert "of 4 devices 4 are not ready" in ran.stderr


def test_a_wrong_baud_rate_is_asked_about(station: Simulated, place: Path) -> None:
    settings = read_station(station.station)
    for role in ROLES:
        device = getattr(settings, role)
        if not isinstance(parse_address(device.address), SerialAddress):
            continue
        one = changed(station, place, role, r"\?baud=\d+", "?baud=38400")
        shares = [r for r in ROLES if getattr(settings, r).address == device.address and r != role]
        if shares:
            # A line has one rate: what stands there twice is refused before anything is opened.
            ran = run("devices", one, "--json")
            assert ran.exit_code == 2
            assert ran.stderr.count("\n") == 1
            continue
        ran = run("devices", one, "--json")
        assert ran.exit_code == 4
        each = found(ran)
        assert [r for r in ROLES if not each[r]["ok"]] == [role]
        trouble = str(each[role]["trouble"])
        assert re.search(r"baud rate|line's speed", trouble), trouble
        assert "38400" in trouble
        assert trouble.endswith(("?", "check baud rate and cable", "check the cable"))


def test_a_wrong_number_on_the_line_is_asked_about(station: Simulated, place: Path) -> None:
    settings = read_station(station.station)
    for role in ROLES:
        key = "device" if hasattr(getattr(settings, role), "device") else "device_id"
        address = parse_address(getattr(settings, role).address)
        # Over TCP most devices answer to any id, the simulated ones too.
        if not hasattr(getattr(settings, role), key) or not isinstance(address, SerialAddress):
            continue
        one = changed(station, place, role, rf"\b{key} = \d+", f"{key} = 17")
        ran = run("devices", one, "--json")
        assert ran.exit_code == 4
        each = found(ran)
        assert [r for r in ROLES if not each[r]["ok"]] == [role]
        trouble = str(each[role]["trouble"])
        assert "device 17" in trouble
        assert re.search(r"its (?:id|number) and|refused, code 11", trouble), trouble


def test_a_port_that_is_not_there_is_told_with_those_that_are(
    station: Simulated, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from loftscan.machine import Port

    here = (Port("/dev/ttyUSB7", "USB-RS485", "", ()),)
    monkeypatch.setattr("loftscan.surveying.ports", lambda: here)
    settings = read_station(station.station)
    for role in ("table", "stage"):
        address = getattr(settings, role).address
        if [getattr(settings, r).address for r in ROLES].count(address) > 1:
            continue
        one = changed(station, place, role, re.escape(address), "serial:///dev/nowhere?baud=115200")
        ran = run("devices", one, "--json")
        assert ran.exit_code == 4
        assert found(ran)[role]["trouble"] == (
            "serial:///dev/nowhere?baud=115200: no such port; is the cable in?"
            " here are /dev/ttyUSB7 (USB-RS485)"
        )


HOLD = """
import sys
from drivers.links import open_link
links = [open_link(address) for address in sys.argv[1:]]
print("held", flush=True)
sys.stdin.read()
"""


@contextmanager
def holding(*addresses: str) -> Iterator[int]:
    """Another program has these ports."""
    words = [sys.executable, "-c", HOLD, *addresses]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        yield holder.pid
        holder.communicate("", timeout=PATIENCE_S)


def test_every_serial_port_that_somebody_holds_is_told_with_the_holder(station: Simulated) -> None:
    settings = read_station(station.station)
    addresses = {role: getattr(settings, role).address for role in ROLES}
    serial = {r: a for r, a in addresses.items() if isinstance(parse_address(a), SerialAddress)}
    with holding(*set(serial.values())) as pid:
        ran = run("devices", station, "--json")
    each = found(ran)
    assert ran.exit_code == 4
    assert {role for role in ROLES if not each[role]["ok"]} == set(serial)
    for role in serial:
        assert f"held by process {pid} (" in str(each[role]["trouble"])
        assert str(each[role]["trouble"]).endswith("end it first")


def test_a_network_device_of_a_scan_that_runs_is_left_alone() -> None:
    """Nobody locks a TCP device: the lock file of the place says who has it."""
    with simulate(seed=3, scale=20.0) as station:
        settings = read_station(station.station)
        address = settings.profiler.address
        (seat,) = places_of([address])
        with seat.file.open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            lock.write(f"{os.getpid()}\n")
            lock.flush()
            told = survey(settings)[ROLES.index("profiler")]
        seat.file.unlink()
    assert told.identity is None
    assert f"{address}: held by process {os.getpid()} (" in told.trouble
    assert told.trouble.endswith("end it first")
    assert holder_at(address) is None


@contextmanager
def forbidden(terminal: Path) -> Iterator[None]:
    """Nobody may open it; root, whom no permission keeps out, becomes nobody meanwhile."""
    if os.geteuid() == 0:
        os.seteuid(65534)
        try:
            yield
        finally:
            os.seteuid(0)
        return
    mode = terminal.stat().st_mode
    terminal.chmod(0)
    try:
        yield
    finally:
        terminal.chmod(mode)


def test_a_port_that_is_not_permitted_says_how_to_be(station: Simulated) -> None:
    settings = read_station(station.station)
    place = parse_address(settings.table.address)
    assert isinstance(place, SerialAddress)
    terminal = Path(os.path.realpath(place.device))
    # The name leads through a folder of the user's own, which nobody else may enter.
    direct = settings.table.address.replace(place.device, str(terminal))
    plain = replace(settings, table=replace(settings.table, address=direct))
    survey(plain)  # everything is imported while it may be read
    with forbidden(terminal):
        told = survey(plain)[ROLES.index("table")]
    assert told.identity is None
    assert told.trouble.startswith(
        f"{direct}: not permitted; on Debian: sudo adduser $USER dialout, then log in again"
    )


def test_a_bad_cable_shows_in_the_counters(place: Path) -> None:
    """One answer in five has a wrong bit: of 40 questions eight are damaged, and asked again."""
    with simulate(seed=3, scale=20.0, faults="garbage=5") as station:
        each = found(succeeded(run("devices", station, "--json", "--times", 20)))
        stage: dict[str, int] = each["stage"]["counters"]  # type: ignore[assignment]
        assert stage["asked"] >= 40
        assert stage["damaged"] + stage["timeouts"] >= stage["asked"] // 5 - 1
        assert stage["repeated"] >= 5
        assert each["laser"]["counters"]["damaged"] == 0  # type: ignore[index]


@pytest.mark.parametrize("role", ["table", "stage", "profiler"])
def test_a_cable_that_is_pulled_meanwhile_is_told_and_the_rest_is_asked(role: str) -> None:
    families = STATIONS["serial"]
    faults = f"unplug-{role}=0,away-ms=60000"
    with simulate(seed=3, scale=20.0, faults=faults, **families) as station:
        ran = run("devices", station, "--json", "--times", 3)
        assert ran.exit_code == 4
        each = found(ran)
        assert [r for r in ROLES if not each[r]["ok"]] == [role]
        trouble = str(each[role]["trouble"])
        assert re.search(r"^serial://\S+: .*is the cable in\?$", trouble), trouble
        # Asked again, the port is not there, and its name says so.
        again = str(found(run("devices", station, "--json"))[role]["trouble"])
        assert ": no such port; is the cable in?" in again
