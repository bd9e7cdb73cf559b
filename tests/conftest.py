"""Several pytest processes share the machine: each keeps to one thread, so do the children that it starts."""

import os

import hypothesis
import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # Before BLAS and OpenMP are loaded, which look only once.
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    from engine.kernels.thread_crew import use_threads

    _alone = use_threads(1)
    _alone.__enter__()


# Of an example, by the clock: on a machine that is shared it says nothing of the code.
hypothesis.settings.register_profile("shared machine", deadline=None)
hypothesis.settings.load_profile("shared machine")


@pytest.fixture
def small_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    """Renders of suspects a quarter as large, for tests that ask what is said of them and not how much they say."""
    monkeypatch.setattr("engine.flows.verify.suspect_evidence.RENDER_SIZE", 256)
