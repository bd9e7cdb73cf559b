"""Several pytest processes share the machine: each keeps to one thread, so do the children that it starts."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from engine.flows.verify.config import CONFIG

TESTS = Path(__file__).parent
PAGE = "tests/service/web/"
STARTED_FIRST = (
    "service/web",
    "service/jobs/test_worker.py",
    "service/flow/test_main_job.py",
    "theory/test_blind.py",
    "registration/test_deformed.py",
    "service/flow/test_backup.py",
    "flows/test_verification.py",
    "pictures/test_cropped_cameras.py",
    "service/flow/test_faults.py",
    "catalogue/test_catalogue.py",
    "pictures/test_camera_finding.py",
    "service/work/test_evidence_pictures.py",
    "registration/test_registering.py",
    "end_to_end/test_cli_main_job.py",
    "service/jobs/test_turns.py",
    "flows/test_coded_pictures.py",
    "service/flow/test_upgrade.py",
    "flows/test_tracing.py",
    "flows/test_looking.py",
    "flows/test_bent_pictures.py",
    "pictures/test_residual.py",
    "kernels/test_native_check.py",
    "service/work/test_variants.py",
    "registration/test_shares.py",
    "service/flow/test_undrawable.py",
    "architecture/test_imports.py",
    "pictures/test_uneven_pixels.py",
    "flows/test_candidates.py",
    "flows/test_spending.py",
    "flows/test_embedding.py",
    "end_to_end/test_cli_refusals.py",
)
"""Files of 20 s and more, longest first: a worker takes whole files, and a long one begun last is waited for alone. The
page's tests go to one worker: they share a service, its model and its claim."""

if "PYTEST_XDIST_WORKER" in os.environ:
    # Before BLAS and OpenMP are loaded, which look only once.
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    from engine.kernels.thread_crew import use_threads

    _alone = use_threads(1)
    _alone.__enter__()


# Of an example, by the clock: on a machine that is shared it says nothing of the code.
hypothesis.settings.register_profile("shared machine", deadline=None)
hypothesis.settings.load_profile("shared machine")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    places = {TESTS / name: place for place, name in enumerate(STARTED_FIRST)}
    items.sort(key=lambda item: places.get(item.path, places.get(item.path.parent, len(places))))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Where a worker takes whole files, it takes those of the page together; None leaves xdist its own."""
    if config.getoption("dist") != "loadfile":
        return None

    from xdist.scheduler import LoadFileScheduling

    scheduling = LoadFileScheduling(config, log)
    file_of = scheduling._split_scope
    scheduling._split_scope = lambda nodeid: PAGE if nodeid.startswith(PAGE) else file_of(nodeid)
    return scheduling


@pytest.fixture
def small_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    """Renders of suspects a quarter as large, for tests that ask what is said of them and not how much they say."""
    small = replace(CONFIG.evidence, render_size=256)
    monkeypatch.setattr("engine.flows.verify.suspect_evidence._CONFIG", small)
