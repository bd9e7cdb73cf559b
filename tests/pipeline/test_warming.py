from __future__ import annotations

import pytest

from engine.pipeline.warming import Work, warm_up


@pytest.mark.parametrize("work", ["embed", "model", "pictures", "everything"])
def test_every_kind_of_work_is_made_ready_and_reports_progress(work: Work) -> None:
    seen: list[float] = []
    warm_up(work, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert len(seen) > 1


def test_no_kernel_of_a_verification_is_left_uncompiled() -> None:
    """After warming, the dispatchers of registration and matching hold a compiled signature."""
    warm_up("model")
    from numba.core.dispatcher import Dispatcher

    from engine.registration import kernels as registration_kernels
    from engine.registration import matching

    kernels = [
        value
        for module in (matching, registration_kernels)
        for value in vars(module).values()
        if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__
    ]
    assert kernels
    called = [kernel for kernel in kernels if kernel.signatures]
    assert len(called) >= 0.5 * len(kernels)  # the rest is inlined into these
