"""Output of the commands: results on stdout, the rest on stderr; for machines JSON instead of both. What cannot be
encoded there, such as a file's name that is no UTF-8, is escaped."""

from __future__ import annotations

import json
import re
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TextIO

from engine.numerics.plain import plain

if TYPE_CHECKING:
    from engine.formats import Repair
    from engine.present.wording import Words


Progress = Callable[[str, float], None]

DATA_ON_STDOUT: ContextVar[bool] = ContextVar("DATA_ON_STDOUT", default=False)
"""Whether stdout is a file that is written: then results for people and machines go to stderr."""

_CONTROLS = re.compile(r"[^\n\t -~\xa0-\U0010ffff]")

LONG_STAGE_SECONDS = 2.0
"""Where stderr is no terminal, a stage that took longer leaves a line."""

STAGES = {
    "read": "reading the model",
    "compile": "compiling kernels",
    "look": "rendering the key views",
    "prune": "pruning to the quality budget",
    "quantize": "quantizing",
    "plan": "planning the watermark",
    "choose": "choosing the settings",
    "mark": "embedding the watermark",
    "refine": "refining the watermark against distortions",
    "landmarks": "building the landmark database",
    "record": "sealing the record",
    "write": "writing",
    "open record": "opening the record",
    "register": "registering the suspect",
    "displacements": "measuring displacements",
    "render": "rendering the suspect at the key views",
    "find camera": "finding the camera of the picture",
    "read picture": "reading the picture",
    "model": "extracting bits from the model",
    "decide": "evaluating the evidence",
    "locate": "locating the watermark",
}
"""Stage names of the engine in words."""


class Console:
    """One command's output. For a `machine` (--json) `say` and `note` are silent and `emit` prints, else not."""

    def __init__(self, machine: bool) -> None:
        self.machine = machine

    def say(self, *lines: str) -> None:
        """Lines of the result, on stdout."""
        for line in lines if not self.machine else ():
            _write(_results(), line)

    def note(self, text: str) -> None:
        """A line on stderr, no part of the result."""
        if not self.machine:
            _write(sys.stderr, text)

    def note_repairs(self, repairs: Iterable[Repair]) -> None:
        """What was mended, ignored or noticed on reading."""
        for repair in repairs:
            self.note(f"on reading: {repair.text}")

    def emit(self, report: Mapping[str, Any]) -> None:
        """The one JSON object on stdout."""
        if self.machine:
            _write(_results(), json.dumps(plain(report), allow_nan=False, indent=1))

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """A callback for the engine's stages: a bar on a terminal, a line a long stage elsewhere."""
        if sys.stderr.isatty():
            with _bar() as callback:
                yield callback
        else:
            with self._lines() as callback:
                yield callback

    @contextmanager
    def _lines(self) -> Iterator[Progress]:
        running: list[tuple[str, float]] = []
        reached = ""

        def close() -> None:
            while running:
                stage, began = running.pop()
                seconds = time.perf_counter() - began
                if seconds >= LONG_STAGE_SECONDS:
                    self.note(f"  {_in_words(stage, reached)}: {seconds:.1f} s")

        def callback(stage: str, fraction: float) -> None:
            nonlocal reached
            stage, _, now = stage.partition(": ")
            if not running or running[-1][0] != stage:
                close()
                running.append((stage, time.perf_counter()))
                reached = ""
            reached = now or reached

        yield callback
        close()


def _results() -> TextIO:
    return sys.stderr if DATA_ON_STDOUT.get() else sys.stdout


def _write(stream: TextIO, text: str) -> None:
    encoding = getattr(stream, "encoding", None) or "utf-8"
    shown = _CONTROLS.sub(lambda found: ascii(found[0])[1:-1], text)  # a file's name may hold a terminal's commands
    stream.write(shown.encode(encoding, "backslashreplace").decode(encoding) + "\n")
    stream.flush()


@contextmanager
def _bar() -> Iterator[Progress]:
    """One line that names the running stage, gone when the work is done."""
    from rich.console import Console as RichConsole
    from rich.progress import BarColumn, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as RichProgress

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with RichProgress(*columns, console=RichConsole(stderr=True), transient=True) as display:
        tasks: dict[str, TaskID] = {}

        def callback(stage: str, fraction: float) -> None:
            stage, _, reached = stage.partition(": ")
            if stage not in tasks:
                for task in tasks.values():
                    display.remove_task(task)
                tasks.clear()
                tasks[stage] = display.add_task(_in_words(stage), total=1.0)
            words = _in_words(stage, reached) if reached else None  # None leaves what stands there
            display.update(tasks[stage], completed=min(max(fraction, 0.0), 1.0), description=words)

        yield callback


def _in_words(stage: str, reached: str = "") -> str:
    """A stage of the engine, and what it has reached, for people."""
    return STAGES.get(stage, stage) + (f" ({reached})" if reached else "")


WIDTH = 96
"""Characters of a line of a claim."""
_LABEL = 16
PARTS = ("says", "does_not_say", "method", "record_time")


def claim_lines(words: Words, *, headline: bool = True, parts: Sequence[str] = PARTS) -> list[str]:
    """A claim as lines of at most WIDTH characters; `parts` of its meaning end it."""
    lines = [*textwrap.wrap(f"{words.headline}. {words.finding}" if headline else words.finding, WIDTH), ""]
    for fact in words.facts:
        lines += textwrap.wrap(
            fact.text, WIDTH, initial_indent=f"  {fact.label:<{_LABEL}}", subsequent_indent=" " * (_LABEL + 2)
        )
    for part in parts:
        lines += ["", *textwrap.wrap(words.meaning[part], WIDTH)]
    return lines
