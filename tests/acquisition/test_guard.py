"""The guard, with owners that are processes and a lamp that this test is.

The lamp is its own witness: it hears "on" and "off", with the monotonic time, on a pty or on a TCP
port, and never speaks of what the owner believes.
"""

from __future__ import annotations

import ast
import json
import os
import select
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from acquisition.errors import GuardLost
from acquisition.safety import guard as guard_process
from acquisition.safety.guard import LAPSED, sentence
from acquisition.safety.guarding import GuardProcess, first_word_s, guarded
from acquisition.safety.places import Place, places_of
from drivers.errors import PortBusy
from drivers.links import open_link
from drivers.recipes import Order, Recipe, Recited, Word
from tests.acquisition.owner_script import RECIPE

REPOSITORY = Path(__file__).resolve().parents[2]
BUSY_S = 2.0  # of a machine that tests; `make safety` has the strict bounds
DEADLY = ("SIGKILL", "SIGSEGV", "os._exit", "SIGSTOP", "GIL held", "sleeping", "forked")


@dataclass
class Lamp:
    """A lamp on a wire, served by a thread."""

    address: str
    deaf_to: int = 0  # words that it does not hear, from the first "off" on
    events: list[tuple[float, str]] = field(default_factory=list)
    lit: bool = False
    connections: int = 0

    def hear(self, word: bytes) -> bytes:
        told = word.decode("ascii", "replace")
        if told == "off" and self.deaf_to:
            self.deaf_to -= 1
            return b""
        self.events.append((time.monotonic(), told))
        if told in ("on", "off"):
            self.lit = told == "on"
            return b"dark\n" if told == "off" else b""
        return b"yes\n" if self.lit else b"no\n"

    def serve(self, descriptor: int) -> None:
        """Until the wire is gone."""
        rest = b""
        while True:
            try:
                ready, _, _ = select.select([descriptor], [], [], 0.02)
                data = os.read(descriptor, 4096) if ready else None
            except OSError:
                return
            if data == b"":
                return
            *words, rest = (rest + (data or b"")).split(b"\n")
            for word in words:
                if answer := self.hear(word):
                    os.write(descriptor, answer)

    def off_after_s(self, since_s: float) -> float:
        """How long after a time it went dark for good."""
        assert not self.lit
        last_on_s = max(at_s for at_s, word in self.events if word == "on")
        return min(at for at, word in self.events if word == "off" and at > last_on_s) - since_s


@pytest.fixture
def port(tmp_path: Path) -> Iterator[Lamp]:
    """A lamp on a serial port; the slave stays open here, so that it outlives its owners."""
    master, slave = os.openpty()
    tty.setraw(slave)
    link = tmp_path / "lamp"
    link.symlink_to(os.ttyname(slave))
    lamp = Lamp(f"serial://{link}?baud=115200")
    thread = threading.Thread(target=lamp.serve, args=(master,), daemon=True)
    thread.start()
    yield lamp
    os.close(master)
    os.close(slave)
    thread.join(5.0)


@pytest.fixture
def network() -> Iterator[Lamp]:
    """A lamp that listens, and serves one connection after the other."""
    listener = socket.create_server(("127.0.0.1", 0))
    lamp = Lamp(f"tcp://127.0.0.1:{listener.getsockname()[1]}")

    def serve() -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            with connection:
                lamp.connections += 1
                lamp.serve(connection.fileno())

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield lamp
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    thread.join(5.0)


def owned(lamp: Lamp, how: str, report: Path) -> tuple[float, subprocess.CompletedProcess[str]]:
    """Let an owner light the lamp and fall; when it had, and how it ended."""
    words = [sys.executable, "-m", "tests.acquisition.owner_script", lamp.address, how, report]
    ran = subprocess.run(
        list(map(str, words)), cwd=REPOSITORY, capture_output=True, text=True, timeout=60,
        check=False,
    )  # fmt: skip
    lit, _, at_s = ran.stdout.partition(" ")
    assert lit == "lit", ran.stderr
    deadline_s = time.monotonic() + 5.0
    while not report.exists() and how != "fine" and time.monotonic() < deadline_s:
        time.sleep(0.01)
    return float(at_s), ran


@pytest.mark.parametrize("how", DEADLY)
def test_whoever_dies_or_hangs_with_the_laser_on_is_killed_and_the_laser_is_off(
    how: str, port: Lamp, tmp_path: Path
) -> None:
    struck_s, ran = owned(port, how, tmp_path / "report.json")
    assert 0.0 < port.off_after_s(struck_s) < BUSY_S
    assert ran.returncode == {"SIGSEGV": -11, "os._exit": 7, "forked": 7}.get(how, -9)
    (report,) = map(json.loads, (tmp_path / "report.json").read_text().splitlines())
    (told,) = report["devices"]
    assert (told["device"], told["confirmed"]) == ("lamp", True)
    assert [word for _, word in port.events].count("off") == 3
    assert port.events[-1][1] == "lit?"  # read back, after the last off
    assert "loftscan guard" in ran.stderr


def test_a_device_on_the_network_is_told_on_the_connection_that_was_passed(
    network: Lamp, tmp_path: Path
) -> None:
    struck_s, _ = owned(network, "SIGKILL", tmp_path / "report.json")
    assert 0.0 < network.off_after_s(struck_s) < BUSY_S
    assert network.connections == 1


def test_where_the_connection_brings_no_answer_it_is_reset_and_a_new_one_tried(
    network: Lamp, tmp_path: Path
) -> None:
    network.deaf_to = 3
    owned(network, "SIGKILL", tmp_path / "report.json")
    report = json.loads((tmp_path / "report.json").read_text())
    assert network.connections == 2
    assert not network.lit
    assert report["devices"][0]["confirmed"]
    assert report["devices"][0]["connection"] == "new"


def test_an_owner_that_is_done_ends_its_guard_in_peace(port: Lamp, tmp_path: Path) -> None:
    _, ran = owned(port, "fine", tmp_path / "report.json")
    assert ran.returncode == 0
    assert ran.stderr == ""
    assert not (tmp_path / "report.json").exists()
    assert [word for _, word in port.events].count("off") == 1


def test_an_owner_that_leaves_with_the_laser_on_is_not_killed_but_the_laser_is_off(
    port: Lamp, tmp_path: Path
) -> None:
    struck_s, ran = owned(port, "left lit", tmp_path / "report.json")
    assert ran.returncode == 0
    assert 0.0 < port.off_after_s(struck_s) < BUSY_S
    assert "not seen to be off" in ran.stderr


def test_a_device_that_does_not_answer_is_reported_with_what_to_do(
    port: Lamp, tmp_path: Path
) -> None:
    port.deaf_to = 1000
    _, ran = owned(port, "SIGKILL", tmp_path / "report.json")
    report = json.loads((tmp_path / "report.json").read_text())
    assert not report["devices"][0]["confirmed"]
    assert "lamp: told, NOT confirmed: press the emergency stop" in ran.stderr


def report(why: str, *devices: tuple[str, bool]) -> dict[str, object]:
    told = [{"device": name, "confirmed": sure, "sent_ms": 1.0, "done_ms": 2.0}
            for name, sure in devices]  # fmt: skip
    return {"why": why, "owner": 7, "owner_end": "killed", "devices": told}


def test_a_lapsed_lease_is_told_with_a_remedy_and_another_end_without() -> None:
    assert "too busy for it: end other work" in sentence(report(f"{LAPSED} 3 ms ago"))
    assert "too busy" not in sentence(report("its owner ended"))


def test_a_stop_that_a_reset_made_good_calls_for_no_emergency_stop() -> None:
    said = sentence(report("its owner ended", ("table", False), ("table, reset", True)))
    assert "table: told, and reset; table, reset: at rest" in said
    assert "emergency" not in said
    said = sentence(report("its owner ended", ("table", False), ("table, reset", False)))
    assert said.count("press the emergency stop") == 2


# --- in one process -------------------------------------------------------------------------------


def test_a_lease_is_renewed_by_the_thread_that_took_it_and_by_no_other(port: Lamp) -> None:
    with guarded([], time.sleep) as guard:
        guard.take(10.0)
        time.sleep(0.03)
        before_s = guard._renewed_s
        other = threading.Thread(target=guard.attend)
        other.start()
        other.join()
        assert guard._renewed_s == before_s
        guard.attend()
        assert guard._renewed_s > before_s
        guard.give_back()


def test_a_guard_that_is_gone_lets_nothing_be_lit() -> None:
    with guarded([], time.sleep) as guard:
        guard.take(10.0)
        guard.give_back()
        guard._process.kill()
        guard._process.wait()
        with pytest.raises(GuardLost, match="nothing may be lit"):
            guard.take(10.0)


def test_a_guard_that_stands_still_is_found_out_before_anything_is_lit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("acquisition.safety.guarding._ANSWER_S", 0.1)
    with guarded([], time.sleep) as guard:
        os.kill(guard._process.pid, 19)
        with pytest.raises(GuardLost, match=r"did not answer to 'take'"):
            guard.take(10.0)
        guard._process.kill()


def test_a_link_that_was_opened_again_is_handed_over_again(port: Lamp) -> None:
    held = Place(port.address, Path("unused"))
    assert held.address == port.address
    with guarded([], time.sleep) as guard:
        link = open_link(port.address)
        guard.hold(link, [RECIPE])
        guard.drop(link)
        link.close()
        again = open_link(port.address)  # refused, if the guard still had it open
        guard.hold(again, [RECIPE])
        guard.take(10.0)  # and is never given back: the guard acts, though we say goodbye
        again.write(b"on\n")
    again.close()
    assert not port.lit
    assert [word for _, word in port.events].count("off") == 3


def test_a_place_is_one_programs_and_a_dead_ones_guard_is_waited_for(
    port: Lamp, tmp_path: Path
) -> None:
    places = [Place("tcp://192.0.2.1:502", tmp_path / "place.lock")]
    with (
        guarded(places, time.sleep),
        pytest.raises(PortBusy, match=rf"192\.0\.2\.1.*process {os.getpid()} .*end it first"),
        guarded(places, time.sleep),
    ):
        pytest.fail("two programs have it")
    (tmp_path / "place.lock").write_text("999999999\n")  # nobody's number: a dead program's
    holder = GuardProcess()
    assert holder.lock([str(places[0].file)])["ok"]
    (tmp_path / "place.lock").write_text("999999999\n")
    waits: list[float] = []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 3:
            holder.end()

    with guarded(places, sleep):
        assert len(waits) == 3


def test_a_place_that_was_let_go_leaves_no_file_and_can_be_had_by_many_in_turn(
    tmp_path: Path,
) -> None:
    places = [Place("tcp://192.0.2.1:502", tmp_path / "place.lock")]
    held = 0
    failures: list[BaseException] = []

    def have() -> None:
        nonlocal held
        for _ in range(3):
            process = GuardProcess()
            try:
                while not process.lock([str(places[0].file)])["ok"]:
                    time.sleep(0.001)
                held += 1
                assert held == 1
                held -= 1
            except BaseException as failed:  # noqa: BLE001 (told by the thread that waits)
                failures.append(failed)
            finally:
                process.end()

    threads = [threading.Thread(target=have) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert not places[0].file.exists()


def test_an_address_has_one_place_however_it_is_spelled(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    (tmp_path / "by-id").symlink_to(port)
    spelled = [
        f"serial://{port}?baud=9600", f"serial://{tmp_path / 'by-id'}",
        "tcp://10.0.0.1:502", "tcp://10.0.0.1:502", "udp://:9009",
    ]  # fmt: skip
    assert len(places_of(spelled)) == 2


def test_the_guard_imports_the_standard_library_only() -> None:
    tree = ast.parse(Path(guard_process.__file__).read_text())
    names = {
        alias.name.partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    } | {
        str(node.module).partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
    }
    assert names <= set(sys.stdlib_module_names)


def test_a_recipe_says_what_it_may_not_be() -> None:
    with pytest.raises(ValueError, match="a word has bytes"):
        Word(b"", b"", 0.1)
    with pytest.raises(ValueError, match="at most 1 s"):
        Word(b"off", b"", 2.0)
    recipe = Recipe("lamp", Order.LASER, (), ())
    assert isinstance(type("Lamp", (), {"recipes": lambda _: (recipe,)})(), Recited)


def test_the_time_that_is_told_is_the_sum_of_what_the_guard_waits_for() -> None:
    assert first_word_s(0.12, 0.0, 0.0) == pytest.approx(0.19)
    assert first_word_s(0.12, 0.021, 0.001) == pytest.approx(0.233)
