"""Turns at something of which little can be done at once: tenants with the fewest at work come first."""

import itertools
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager


class Turns:
    """`at_once` callers at a time; the others wait, in threads of their own."""

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        self._numbers = itertools.count()
        self._waiting: set[tuple[int, str]] = set()  # number of coming, tenant
        self._at_work: Counter[str] = Counter()
        self._changed = threading.Condition()

    @contextmanager
    def of(self, tenant: str) -> Iterator[None]:
        """Wait for a turn of this tenant's, and have it."""
        me = (next(self._numbers), tenant)
        with self._changed:
            self._waiting.add(me)
            self._changed.wait_for(lambda: self._next() == me)
            self._waiting.remove(me)
            self._at_work[tenant] += 1
            self._changed.notify_all()
        try:
            yield
        finally:
            with self._changed:
                self._at_work -= Counter([tenant])  # drops who has none left
                self._changed.notify_all()

    def _next(self) -> tuple[int, str] | None:
        if self._at_work.total() >= self._at_once:
            return None
        return min(self._waiting, key=lambda each: (self._at_work[each[1]], each[0]))
