"""Cores and programs of this machine."""

import os
import sys


def usable_cores() -> int:
    """Those that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def module_command(name: str) -> list[str]:
    """How to run a module of ours as a program, with this Python and what it finds modules in."""
    program = f"import runpy, sys; sys.path[:] = {sys.path!r}; runpy.run_module({name!r}, run_name='__main__')"
    return [sys.executable, "-c", program]
