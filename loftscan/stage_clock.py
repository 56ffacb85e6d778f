"""Wall-clock seconds by stage, where the stages take turns."""

from __future__ import annotations

from collections.abc import Callable


class StageClock:
    """A stopwatch with a hand for each stage; only one runs."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._stage: str | None = None
        self._since_s = now_s()
        self._seconds: dict[str, float] = {}

    def to(self, stage: str | None) -> None:
        """Let the hand of a stage run; None: of nobody's."""
        now = self._now_s()
        if self._stage is not None:
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._since_s
        self._stage, self._since_s = stage, now

    @property
    def seconds(self) -> dict[str, float]:
        """Of every stage that ran."""
        return {stage: round(seconds, 4) for stage, seconds in self._seconds.items()}
