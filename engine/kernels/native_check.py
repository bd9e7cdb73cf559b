"""Whether this machine may call kernels without numba: compared once with numba itself, in a process of its own.

What is kept as machine code comes from numba's internals and is called by a convention that numba does not promise. So
before it is relied on, a kernel with arguments of every kind runs both ways, and both must give the same numbers and
write the same bytes, none outside. Whatever else happens, a crash included, numba runs every kernel here.
"""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

from engine.errors import Mark3DGSError
from engine.kernels import kernel_cache

BEFORE_NUMBA = (0, 69)
"""The first untested version of numba; `pyproject.toml` has the same bound."""
SECONDS = 300.0
"""After which a comparison has failed: it takes one, on a machine that may be busy."""
ENDED_BY_OTHERS = (1, -9, -15)
"""Exit codes of a comparison that say nothing of machine code and are not remembered: Python could not begin, or the
system ended it (SIGKILL, SIGTERM)."""


@cache
def calls_native() -> bool:
    """Whether kernels are called as machine code. The environment variable MARK3DGS_KERNELS is `auto`, which is the
    default: where it gives what numba gives; or `numba`: never. Mark3DGSError where it is something else."""
    setting = os.environ.get("MARK3DGS_KERNELS") or "auto"
    if setting not in ("auto", "numba"):
        raise Mark3DGSError(f"MARK3DGS_KERNELS is {setting!r}: it can be 'auto' or 'numba'")
    wrong = "" if setting == "numba" else verdict()
    if wrong:
        kernel_cache.warn_once("KERNELS", f"kernels start more slowly, by numba alone: {wrong}")
    return setting == "auto" and not wrong


def verdict() -> str:
    """What is wrong with machine code here, for this numba, llvmlite and processor; empty where nothing is."""
    numba = kernel_cache.compiler()[0]
    if tuple(int(part) for part in numba.split(".")[:2]) >= BEFORE_NUMBA:
        return f"numba {numba} is newer than what is known here"
    probe = Path(__file__).with_name("native_probe.py").read_text()
    name = kernel_cache.path_of("native", "verdict", sys.version, probe)
    if (kept := kernel_cache.read(name)) is not None:
        return kept.decode(errors="replace")
    try:
        done = _ask()
    except (OSError, subprocess.SubprocessError) as error:
        return f"the check of machine code did not run: {error}"
    wrong = done.stdout.decode() if done.returncode == 0 else f"its check ended with status {done.returncode}"
    if done.returncode not in ENDED_BY_OTHERS:
        kernel_cache.write(name, wrong.encode())
    return wrong


def _ask() -> subprocess.CompletedProcess[bytes]:
    """Compare in a new process, which machine code that is called in a wrong way may end."""
    command = module_command("engine.kernels.native_probe")
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=SECONDS, check=False)


def module_command(name: str) -> list[str]:
    """How to run a module of ours as a program, with this Python and what it finds modules in."""
    program = f"import runpy, sys; sys.path[:] = {sys.path!r}; runpy.run_module({name!r}, run_name='__main__')"
    return [sys.executable, "-c", program]
