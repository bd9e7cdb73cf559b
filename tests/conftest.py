"""Several pytest processes share the machine: each keeps to one thread, so do the children that it starts."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from engine.flows.verify.config import CONFIG
from engine.model import GaussianModel

TESTS = Path(__file__).parent
OF_ONE_ROOM = {
    "catalogue": "catalogue",
    "flows": "merged_models bent_pictures blurred_pictures changed_colors",
    "formats": "usd gltf_hostile oracles every_pair",
    "kernels": "native_check machine_code kernel_cache",
    "pictures": "cropped_cameras uneven_pixels blur view_climb plain_ground residual light_and_tone local_alignment "
    "color_change voted_views following_cameras order_of_blending",
    "registration": "deformed merged sketch mirrors shares",
    "service/api": "upload_protocol hostile",
    "service/cli": "one_service",
    "service/jobs": "turns port worker",
    "service/trust": "audit master",
    "service/web": "behaviour claim_view digests jobs lists settings",
    "service/work": "by_content variants",
}
"""Files of tests, by folder, of how one room works inside, which take long: `.ci/run` plays them where a change touches
that room of the engine or the service, `make full` always; `make test` plays what other rooms notice of it."""
TOGETHER = tuple(
    f"tests/{name}/" for name in ("service/web", "end_to_end", "service/work", "service/api", "architecture")
)
"""Folders whose tests go to one worker each: they share a service, a marked model or the parsed tree."""
STARTED_FIRST = (
    "service/web",
    "end_to_end",
    "service/work",
    "service/api",
    "service/flow/test_main_job.py",
    "flows/test_verification.py",
    "pictures/test_camera_finding.py",
    "service/jobs/test_worker.py",
    "theory/test_blind.py",
    "flows/test_dispute.py",
    "registration/test_registering.py",
    "pictures/test_cropped_cameras.py",
    "architecture",
    "catalogue/test_catalogue.py",
    "flows/test_embedding.py",
    "flows/test_changed_colors.py",
    "flows/test_tracing.py",
    "flows/test_merged_models.py",
    "pictures/test_blur.py",
    "pictures/test_residual.py",
    "registration/test_deformed.py",
    "pictures/test_light_and_tone.py",
    "service/flow/test_draws.py",
    "service/flow/test_upgrade.py",
    "flows/test_spending.py",
    "flows/test_bent_pictures.py",
    "registration/test_shares.py",
    "flows/test_coded_pictures.py",
    "pictures/test_plain_ground.py",
    "examples/test_examples.py",
    "kernels/test_native_check.py",
    "formats/test_usd.py",
    "kernels/test_machine_code.py",
    "flows/test_blurred_pictures.py",
    "flows/test_candidates.py",
    "flows/test_picture_layers.py",
    "registration/test_merged.py",
    "flows/test_mirrors.py",
    "service/cli/test_one_service.py",
    "pictures/test_uneven_pixels.py",
    "pictures/test_view_climb.py",
    "pictures/test_local_alignment.py",
    "flows/test_chaff.py",
    "service/jobs/test_turns.py",
    "flows/test_looking.py",
    "service/flow/test_faults.py",
)
"""Folders and files of 20 s and more, longest first: a worker takes them whole, and a long one begun last is waited for
alone."""

if "PYTEST_XDIST_WORKER" in os.environ:
    # Before BLAS and OpenMP are loaded, which look only once.
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    from engine.kernels.thread_crew import use_threads

    _alone = use_threads(1)
    _alone.__enter__()


# Of an example, by the clock: on a machine that is shared it says nothing of the code.
hypothesis.settings.register_profile("shared machine", deadline=None)
hypothesis.settings.load_profile("shared machine")


ROOMS = {TESTS / room / f"test_{name}.py" for room, names in OF_ONE_ROOM.items() for name in names.split()}


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """What is not to run is not even imported, which each worker would do: a third of the time until the first test."""
    left_out = {mark for mark in ("docker", "lab", "room") if f"not {mark}" in config.getoption("markexpr")}
    if collection_path in ROOMS:
        return "room" in left_out or None
    return (collection_path.parent == TESTS and collection_path.name in left_out) or None


@pytest.hookimpl(tryfirst=True)  # before they are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path in ROOMS:
            item.add_marker("room")
    places = {TESTS / name: place for place, name in enumerate(STARTED_FIRST)}
    items.sort(key=lambda item: places.get(item.path, places.get(item.path.parent, len(places))))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Where a worker takes whole files, it takes some folders whole; None leaves xdist its own."""
    if config.getoption("dist") != "loadfile":
        return None

    from xdist.scheduler import LoadFileScheduling

    scheduling = LoadFileScheduling(config, log)
    file_of = scheduling._split_scope
    scheduling._split_scope = lambda nodeid: next(filter(nodeid.startswith, TOGETHER), None) or file_of(nodeid)
    return scheduling


@pytest.fixture(scope="session")
def plant() -> GaussianModel:
    """The shipped scene."""
    from engine.formats import read_model

    return read_model(TESTS / "data" / "plant.splat").model


@pytest.fixture
def small_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    """Renders of suspects a quarter as large, for tests that ask what is said of them and not how much they say."""
    small = replace(CONFIG.evidence, render_size=256)
    monkeypatch.setattr("engine.flows.verify.suspect_evidence._CONFIG", small)
