"""How long a search may take: a limit that is looked at between whole steps only.

A step that began is finished and gives what it always gives; a step that would begin after the limit is left out and
listed. So the clock decides which steps there are, never the result of one: what ends in time is the same to the last
byte on any machine.
"""

import math
import time
from collections.abc import Callable


class TimeBudget:
    """Seconds of wall-clock time from now on; `left_out` names the steps that it did not allow."""

    def __init__(self, seconds: float = math.inf, now: Callable[[], float] = time.perf_counter) -> None:
        self.seconds = seconds
        self.left_out: tuple[str, ...] = ()
        self._now = now
        self._end = now() + seconds
        self._resting = 0.0

    def allows(self, step: str) -> bool:
        """Whether this step may begin; if not, it is listed in `left_out`."""
        if self._now() < self._end:
            return True
        if step not in self.left_out:
            self.left_out += (step,)
        return False

    def rest(self) -> None:
        """Time does not count from here on, until `go_on`."""
        self._resting = self._now()

    def go_on(self) -> None:
        """Time counts again."""
        self._end += self._now() - self._resting


UNLIMITED = TimeBudget()
"""Allows every step."""
