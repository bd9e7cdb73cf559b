"""The log of `serve` and `worker`: warnings and errors on standard error, each place in the code so often a minute."""

import logging
import sys

MOST, SECONDS = 20, 60.0


class Repeats(logging.Filter):
    """At most MOST messages of one place in SECONDS; the next one after that says how many were left out."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: dict[tuple[str, int], tuple[float, int]] = {}  # since when, and how many

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the message is written."""
        place = (record.pathname, record.lineno)
        since, count = self._seen.get(place, (record.created, 0))
        if record.created - since >= SECONDS:
            if count > MOST:
                record.msg, record.args = f"{record.getMessage()} ({count - MOST} more were left out before)", None
            since, count = record.created, 0
        self._seen[place] = since, count + 1
        return count < MOST


def set_up() -> None:
    """Hand all loggers, those of the web server and of the event loop too, to one such handler."""
    handler = logging.StreamHandler(sys.stderr)
    handler.addFilter(Repeats())
    logging.basicConfig(handlers=[handler], level=logging.WARNING, format="%(levelname)s: %(message)s")
