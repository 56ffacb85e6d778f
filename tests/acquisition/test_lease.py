"""The laser is on under a lease only, off on every way out, and no wait is a long one."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from acquisition.errors import LeaseLapsed
from acquisition.lease import TTL_S, Lease, lasing, pausing
from drivers.axis import Identity
from drivers.endings import at_last
from drivers.errors import NoReply, Refused
from drivers.laser import Guarantee


@dataclass
class Clock:
    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        assert 0.0 < seconds <= 0.05
        self.now_s += seconds


@dataclass
class Laser:
    """Its own witness: `lit` is what the contact does."""

    clock: Clock
    lit: bool = False
    slow_s: float = 0.0  # how long switching on takes
    off_fails: bool = False
    on_fails: bool = False
    log: list[str] = field(default_factory=list)

    def on(self) -> None:
        self.log.append("on")
        self.lit = True  # before it is read back: a failing `on` may have lit it
        self.clock.now_s += self.slow_s
        if self.on_fails:
            raise Refused("laser: the output did not follow")

    def off(self) -> None:
        self.log.append("off")
        if self.off_fails:
            raise Refused("laser: press the emergency stop")
        self.lit = False

    def is_on(self) -> bool:
        return self.lit

    def identify(self) -> Identity:
        raise AssertionError("not asked")

    def guarantee(self) -> Guarantee:
        raise AssertionError("not asked")


def test_a_lease_begins_lapsed_lives_its_time_and_can_be_renewed() -> None:
    clock = Clock()
    lease = Lease(0.12, clock)
    assert not lease.valid
    lease.renew()
    clock.now_s += 0.11
    assert lease.valid
    lease.renew()
    clock.now_s += 0.11
    assert lease.valid
    clock.now_s += 0.02
    assert not lease.valid
    lease.renew()
    assert lease.valid


def test_a_lease_needs_a_time_to_live() -> None:
    with pytest.raises(ValueError, match="must be above 0"):
        Lease(0.0, Clock())


def test_the_laser_is_on_inside_and_off_outside() -> None:
    clock = Clock()
    laser = Laser(clock)
    with lasing(laser, Lease(TTL_S, clock)):
        assert laser.lit
    assert not laser.lit
    assert laser.log == ["on", "off"]


@pytest.mark.parametrize("reason", [RuntimeError, KeyboardInterrupt, GeneratorExit, NoReply])
def test_the_laser_is_off_whatever_is_raised(reason: type[BaseException]) -> None:
    clock = Clock()
    laser = Laser(clock)
    with pytest.raises(reason), lasing(laser, Lease(TTL_S, clock)):
        raise reason
    assert not laser.lit


def test_off_is_sent_even_where_on_failed() -> None:
    clock = Clock()
    laser = Laser(clock, on_fails=True)
    with pytest.raises(Refused, match="did not follow"), lasing(laser, Lease(TTL_S, clock)):
        pytest.fail("the block was entered")
    assert not laser.lit


def test_an_off_that_fails_is_raised_and_is_a_note_of_an_error_before() -> None:
    clock = Clock()
    laser = Laser(clock, off_fails=True)
    with pytest.raises(Refused, match="emergency stop"), lasing(laser, Lease(TTL_S, clock)):
        pass
    with pytest.raises(RuntimeError, match="first") as first, lasing(laser, Lease(TTL_S, clock)):
        raise RuntimeError("first")
    assert first.value.__notes__ == ["laser: press the emergency stop"]


def test_keeping_on_renews_the_lease_and_the_switch() -> None:
    clock = Clock()
    laser, lease = Laser(clock), Lease(TTL_S, clock)
    with lasing(laser, lease) as keep_on:
        for _ in range(10):
            clock.now_s += 0.1
            keep_on()
        clock.now_s += 0.1
        assert lease.valid
    assert laser.log == ["on"] * 11 + ["off"]


def test_a_program_that_was_stopped_while_it_kept_the_laser_on_puts_it_off() -> None:
    clock = Clock()
    laser, lease = Laser(clock), Lease(TTL_S, clock)
    with pytest.raises(LeaseLapsed), lasing(laser, lease) as keep_on:  # noqa: PT012
        laser.slow_s = 0.6  # a signal held it in the middle of switching
        keep_on()
    assert not laser.lit


def test_a_lease_that_lapsed_with_the_laser_on_is_an_error_and_never_lights_it_again() -> None:
    clock = Clock()
    laser = Laser(clock)
    lease = Lease(TTL_S, clock)
    with pytest.raises(LeaseLapsed, match=r"0\.12 s"), lasing(laser, lease) as keep_on:  # noqa: PT012
        clock.now_s += 0.13
        keep_on()
    assert laser.log == ["on", "off"]


def test_switching_on_too_slowly_lapses_the_lease() -> None:
    clock = Clock()
    laser = Laser(clock, slow_s=0.13)
    with pytest.raises(LeaseLapsed), lasing(laser, Lease(TTL_S, clock)):
        pytest.fail("the block was entered")
    assert not laser.lit


def test_a_lease_that_lapsed_in_the_dark_does_not_keep_the_laser_from_being_lit() -> None:
    clock = Clock()
    laser, lease = Laser(clock), Lease(TTL_S, clock)
    lease.renew()
    clock.now_s += 5.0
    with lasing(laser, lease):
        assert laser.lit
        assert lease.valid


@pytest.mark.parametrize("seconds", [0.0, 0.01, 0.05, 0.3, 1.234])
def test_a_pause_takes_its_time_in_steps_that_renew_and_look(seconds: float) -> None:
    clock = Clock()
    lease = Lease(TTL_S, clock)
    looks: list[float] = []
    pausing(lease, lambda: looks.append(clock.now_s), clock.sleep)(seconds)
    assert clock.now_s == pytest.approx(100.0 + seconds)
    assert looks[0] == 100.0
    assert looks[-1] == clock.now_s
    assert max(b - a for a, b in zip(looks, looks[1:] or looks, strict=False)) <= 0.05 + 1e-9
    assert lease.valid


def test_a_stop_abandons_a_pause_at_once() -> None:
    clock = Clock()

    def look() -> None:
        if clock.now_s >= 100.1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pausing(Lease(TTL_S, clock), look, clock.sleep)(10.0)
    assert clock.now_s <= 100.16


def test_what_is_done_at_last_is_done_once_on_every_way_out() -> None:
    done: list[str] = []
    with at_last(lambda: done.append("end")):
        pass
    with pytest.raises(KeyError), at_last(lambda: done.append("error")):
        raise KeyError
    assert done == ["end", "error"]
