"""Progress and time by stage, for people (a callback) and for machines (seconds_by_stage)."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[str, float], None]
"""Called as progress(stage name, fraction of that stage done in 0..1); ": " and the value by now may follow."""


class Clock:
    """Times named stages and reports them as they start, advance and end."""

    def __init__(self, progress: Progress | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress
        self._began = time.perf_counter()
        self._stage = ""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one stage; the seconds of one name add up."""
        began = time.perf_counter()
        self._stage = name
        self.advance(0.0)
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
        self.advance(1.0)

    def advance(self, fraction: float, reached: str = "") -> None:
        """Say how far the running stage is, and what it has reached by now."""
        if self._progress is not None:
            self._progress(f"{self._stage}: {reached}" if reached else self._stage, fraction)

    @property
    def total(self) -> float:
        """Seconds since the clock was made."""
        return time.perf_counter() - self._began
