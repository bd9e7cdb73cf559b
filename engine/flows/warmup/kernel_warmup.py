"""Make the kernels of a job ready before it begins: loaded as they were kept, or compiled.

Compiling is work for one core at a time, so the first kernel that is found to be missing calls helpers: processes that
each compile steps of `engine.flows.warmup.warmup_steps` and keep what they made, which this process then loads.
"""

import subprocess
import threading
from collections.abc import Callable, Mapping

from engine.flows.warmup.warmup_steps import Step, Work, steps_of
from engine.kernels.kernel_cache import folder
from engine.kernels.machine_code import on_compiling
from engine.kernels.native_check import module_command
from engine.kernels.thread_crew import usable_cores

__all__ = ["Work", "expected_seconds", "warm_up"]

MOST_PROCESSES = 4
"""That compile at a time: each is a Python of its own with a compiler in it, and more would not end before the
longest step."""


def warm_up(
    work: Work,
    progress: Callable[[float], None] | None = None,
    processes: int | None = None,
    compiling: Callable[[], None] = lambda: None,
    enough: Callable[[], bool] = lambda: False,
) -> None:
    """Make the kernels of some work ready; `progress` is called with the fraction done, 0 to 1, by the time that
    compiling takes, and `compiling` is called once where a kernel is not there yet. `processes`, as many as there are
    cores by default, at most compile side by side; only this one where nothing can be kept. As long as kernels are only
    loaded, it ends as soon as that is `enough`."""
    steps = steps_of(work)
    plan = _Plan(steps, progress or (lambda fraction: None))
    begun = False

    def begin() -> None:
        nonlocal begun
        if not begun:
            begun = True
            compiling()
            for _ in range((processes or _cores()) - 1 if folder() else 0):
                threading.Thread(target=_help, args=(plan,), daemon=True).start()

    on_compiling.append(begin)
    try:
        mine = set()
        while (name := plan.take()) is not None:
            steps[name].run()
            mine.add(name)
            plan.finish(name)
            if not begun and enough():
                return
        plan.wait()
        for name in [each for each in steps if each not in mine]:
            steps[name].run()  # from the cache; where a helper has failed, compiled after all
    finally:
        on_compiling.remove(begin)
    plan.progress(1.0)


def expected_seconds(work: Work) -> float:
    """About how long it takes where nothing is compiled yet."""
    steps, ends = steps_of(work), dict[str, float]()
    for name, step in steps.items():
        ends[name] = step.seconds + max((ends.get(before, 0.0) for before in step.after), default=0.0)
    return max(sum(step.seconds for step in steps.values()) / _cores(), *ends.values())


def _cores() -> int:
    return min(usable_cores(), MOST_PROCESSES)


class _Plan:
    """Which steps are taken and done; shared by the threads of one `warm_up`."""

    def __init__(self, steps: Mapping[str, Step], progress: Callable[[float], None]) -> None:
        self._steps, self.progress = steps, progress
        self._taken, self._done = set[str](), set[str]()
        self._changed = threading.Condition()

    def take(self) -> str | None:
        """The next step whose predecessors are done, waiting for them; None where all are taken."""
        with self._changed:
            while len(self._taken) < len(self._steps):
                for name, step in self._steps.items():
                    if name not in self._taken and self._done.issuperset(self._steps.keys() & step.after):
                        self._taken.add(name)
                        return name
                self._changed.wait()
            return None

    def finish(self, name: str) -> None:
        """A step is done."""
        with self._changed:
            self._done.add(name)
            self._changed.notify_all()
            share = sum(self._steps[each].seconds for each in self._done)
            self.progress(0.99 * share / sum(step.seconds for step in self._steps.values()))

    def wait(self) -> None:
        """Until every step is done."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._done) == len(self._steps))


def _help(plan: _Plan) -> None:
    """Take steps and have them compiled by a process of its own, one for all of them: half of a small step's time is a
    Python's start."""
    program: subprocess.Popen[bytes] | None = None
    while (name := plan.take()) is not None:
        try:
            program = program or subprocess.Popen(
                module_command("engine.flows.warmup.warmup_steps"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,  # nothing is left to be written to a program that has ended
            )
            _ask(program, name)
        except OSError:
            pass  # the caller compiles what has not been
        finally:
            plan.finish(name)
    if program is not None:
        with program:
            program.kill()


def _ask(program: subprocess.Popen[bytes], step: str) -> None:
    """Have a step made ready; returns when it is, or when the program has ended."""
    if program.stdin is not None and program.stdout is not None:
        program.stdin.write(step.encode() + b"\n")
        program.stdout.readline()
