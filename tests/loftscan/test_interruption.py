"""Ctrl-C is not lost where compiled code swallows the exception that Python makes of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import typer

from loftscan.commands.running import run
from loftscan.interruption import interruptible
from loftscan.progress import silent


def press() -> None:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1.0)  # a handler is called before this is over


@contextmanager
def swallowed() -> Iterator[None]:
    """As numba's dispatcher may: the exception is cleared."""
    with pytest.raises(KeyboardInterrupt):
        press()
    yield


def test_a_key_that_was_swallowed_is_found_at_the_next_pause_and_the_next_step() -> None:
    with interruptible() as interruption, swallowed():
        pauses: list[float] = []
        with pytest.raises(KeyboardInterrupt):
            interruption.pausing(pauses.append)(0.05)
        with pytest.raises(KeyboardInterrupt):
            interruption.heeding(silent)("sections", 1, 2)
        assert pauses == []


def pressed_in_compiled_code() -> None:
    """What numba's dispatcher gives when the key comes half-way."""
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt as key:
        raise SystemError("a result with an exception set") from key


def test_what_compiled_code_makes_of_a_key_leaves_the_block_as_the_key() -> None:
    with pytest.raises(KeyboardInterrupt), interruptible():
        pressed_in_compiled_code()


def test_a_system_error_without_a_key_stays_one() -> None:
    with pytest.raises(SystemError, match="of its own"), interruptible():
        raise SystemError("of its own")


def test_without_a_key_whoever_waits_waits_and_who_tells_tells() -> None:
    pauses: list[float] = []
    steps: list[tuple[str, int, int]] = []
    with interruptible() as interruption:
        interruption.pausing(pauses.append)(0.05)
        interruption.heeding(lambda *step: steps.append(step))("sections", 1, 2)
    assert (pauses, steps) == ([0.05], [("sections", 1, 2)])


def test_a_handler_of_somebody_else_is_left_alone_and_ours_goes_with_the_block() -> None:
    with interruptible():
        assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interruptible():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_what_compiled_code_makes_of_a_key_is_the_operators_stop(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def kernel() -> None:
        # As CPython tells of C functions that return with an exception set, numba's two here.
        inner = SystemError("_numba_unpickle returned a result with an exception set")
        inner.__cause__ = KeyboardInterrupt()
        raise SystemError("CPUDispatcher returned a result with an exception set") from inner

    with pytest.raises(typer.Exit) as left:
        run(kernel, debug=False)
    assert left.value.exit_code == 3
    assert capsys.readouterr().err == "loftscan: stopped by the operator; nothing was written\n"


def test_any_other_error_of_compiled_code_is_not_hidden() -> None:
    def kernel() -> None:
        raise SystemError("broken")

    with pytest.raises(SystemError):
        run(kernel, debug=False)


HALF_MADE = """
import sys
import loftscan.cli

class HalfMade:
    def __del__(self):
        raise ValueError("half made")

def interrupted():
    half_made = HalfMade()
    raise SystemExit(int(sys.argv[1]))

loftscan.cli.app = interrupted
loftscan.cli.main()
"""


@pytest.mark.parametrize("code", [3, 1])
def test_what_was_half_made_when_the_key_was_pressed_is_not_complained_of(code: int) -> None:
    words = [sys.executable, "-c", HALF_MADE, str(code)]
    ran = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ran.returncode == code
    assert ("half made" in ran.stderr) == (code != 3)
