"""The engine, the images and the built image, once for all tests here."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docker.engine import docker_engine, take_away
from tests.docker.images import images, run
from tests.docker.stack import COMPOSE, IMAGE, ROOT, Stack

HERE = Path(__file__).parent
EMBEDDED = ROOT / "docker" / "compose.yaml"
SCALE = ROOT / "docker" / "compose.scale.yaml"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All of this is marked `docker`, which only `make docker-test` runs; the first test waits for the build."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.docker)
            item.add_marker(pytest.mark.timeout(1800))


@pytest.fixture(scope="session")
def image(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The image, built by compose.yaml as it is shipped."""
    if not COMPOSE.exists():
        pytest.skip("docker-compose is missing: install the extra docker-test")
    folder = tmp_path_factory.mktemp("docker")
    try:
        with docker_engine(), images(folder):
            Stack("mark3dgs-test", [EMBEDDED, HERE / "compose.build.yaml"], {}).compose("build", "--quiet")
            try:
                yield IMAGE
            finally:
                run("docker", "image", "rm", "--force", IMAGE)
    finally:
        take_away()


@pytest.fixture(scope="session")
def plant() -> bytes:
    """A real scene of 94k Gaussians."""
    return (ROOT / "tests" / "data" / "plant.splat").read_bytes()


def another(plant: bytes, number: int) -> bytes:
    """The same scene as another original: without its first rows. Copies of one original are marked with the same
    settings, and later ones in a fraction of the time."""
    return plant[32 * number :]
