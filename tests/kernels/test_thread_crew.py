"""Threads that take turns: every turn once, by any thread; failures, forks, many callers."""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from engine.kernels.thread_crew import run_turns, thread_count, use_threads


@pytest.mark.parametrize(("turns", "threads"), [(0, None), (1, None), (2, None), (7, None), (7, 1), (7, 2), (1, 3)])
def test_every_turn_is_taken_once(turns: int, threads: int | None) -> None:
    taken: list[int] = []
    run_turns(taken.append, turns, threads)
    assert sorted(taken) == list(range(turns))


def test_turns_run_side_by_side() -> None:
    together = threading.Barrier(3, timeout=30.0)
    run_turns(lambda number: together.wait(), 3)


def test_it_is_over_when_the_slowest_is() -> None:
    together, caller, over = threading.Barrier(2, timeout=30.0), threading.current_thread(), list[int]()

    def turn(number: int) -> None:
        together.wait()
        if threading.current_thread() is not caller:
            time.sleep(0.3)
        over.append(number)

    run_turns(turn, 2)
    assert sorted(over) == [0, 1]


def test_who_asks_gets_done_though_nobody_comes() -> None:
    block, started = threading.Event(), threading.Barrier(2, timeout=30.0)

    def hold(number: int) -> None:
        if number == 1:
            started.wait()
            block.wait(30.0)
        else:
            started.wait()

    holder = threading.Thread(target=lambda: run_turns(hold, 2))
    holder.start()
    taken: list[int] = []
    run_turns(taken.append, 2)  # the helper may be held by the other
    assert sorted(taken) == [0, 1]
    block.set()
    holder.join()


def test_a_failure_is_raised_when_all_are_over() -> None:
    over: list[int] = []

    def turn(number: int) -> None:
        if number == 0:
            raise ValueError("turn 0")
        over.append(number)

    with pytest.raises(ValueError, match="turn 0"):
        run_turns(turn, 4)
    assert sorted(over) == [1, 2, 3]


def test_many_callers_at_once() -> None:
    def ask(base: int) -> list[int]:
        taken: list[int] = []
        for _ in range(50):
            run_turns(lambda number: taken.append(base + number), 3)
        return taken

    with ThreadPoolExecutor(4) as pool:
        for base, taken in zip(range(0, 400, 100), pool.map(ask, range(0, 400, 100)), strict=True):
            assert sorted(taken) == sorted([base, base + 1, base + 2] * 50)


def test_threads_are_counted_for_each_caller() -> None:
    before = thread_count()
    with use_threads(5):
        assert thread_count() == 5
        with use_threads(1):
            assert thread_count() == 1
        assert thread_count() == 5
        with ThreadPoolExecutor(1) as pool:
            assert pool.submit(thread_count).result() != 5
    assert thread_count() == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_a_crew_of_its_own() -> None:
    run_turns(lambda number: None, 3)
    child = os.fork()
    if child == 0:
        together = threading.Barrier(3, timeout=10.0)
        try:
            run_turns(lambda number: together.wait(), 3)
            os._exit(0)
        finally:
            os._exit(1)
    assert os.waitpid(child, 0)[1] == 0
