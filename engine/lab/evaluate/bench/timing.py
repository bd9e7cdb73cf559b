"""Timing of work: repeated, in a process of its own where its peak memory counts; medians with extremes."""

import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

from engine.kernels.allocation import keep_freed_memory

T = TypeVar("T")


def in_own_process(function: Callable[..., T], *arguments: object) -> T:
    """Result of a module-level function run in a fresh process."""
    context = get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=context, initializer=keep_freed_memory) as pool:
        return pool.submit(function, *arguments).result()


def spread(seconds: Sequence[float], name: str = "seconds") -> dict[str, float]:
    """Median and extremes of repeated timings."""
    return {name: statistics.median(seconds), f"{name}_least": min(seconds), f"{name}_most": max(seconds)}


def stage_medians(runs: Sequence[dict[str, float]]) -> dict[str, float]:
    """Median of each stage over runs."""
    return {stage: statistics.median(run[stage] for run in runs) for stage in runs[0]}


def seconds_of(work: Callable[[], object]) -> float:
    """Of one run."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Milliseconds of `work`, median of `repeats` runs after one that is not timed."""
    work()
    return round(1000.0 * statistics.median(seconds_of(work) for _ in range(repeats)), 2)
