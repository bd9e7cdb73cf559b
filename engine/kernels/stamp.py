"""Whether the kernels of some work have been compiled here before, told without loading one.

Numba keeps what it compiles by the date and size of the source file, its own version and the processor. A stamp says
the same of a whole work: its name is a digest of those. Who trusts one that is out of date waits for kernels without
having been told; nothing else goes wrong.
"""

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

from engine.kernels.machine_code import compiler, processor, store

__all__ = ["is_stamped", "stamp"]

_ENGINE = Path(__file__).parents[1]


def is_stamped(work: str) -> bool:
    """Whether every kernel of some work was compiled by this Python, with these sources, for this processor."""
    return any(_path(each).exists() for each in (work, "everything"))


def stamp(work: str) -> None:
    """Say so; where nothing can be written nothing is said."""
    try:
        _path(work).parent.mkdir(parents=True, exist_ok=True)
        _path(work).touch()
    except OSError:
        pass


def _path(work: str) -> Path:
    digest = hashlib.sha256("\0".join([work, *_facts()]).encode()).hexdigest()
    return store() / f"kernels-{digest[:32]}.stamp"


def _facts() -> Iterator[str]:
    yield from (sys.version, *compiler(), *processor())
    for source in sorted(_ENGINE.rglob("*.py")):
        facts = source.stat()
        yield f"{source.relative_to(_ENGINE)} {facts.st_mtime_ns} {facts.st_size}"
