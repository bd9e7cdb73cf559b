"""What every container of docker/compose*.yaml has: limits, logs that end, and a health check; what is in the image."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import pytest

from engine.formats.known_formats import KINDS
from tests.architecture.tree import ROOT

yaml = pytest.importorskip("yaml")

SEEN_OTHERWISE = {
    "worker": "other workers notice its silence in the database",
    "bucket": "runs once, and others wait for its success",
}
OF_THE_IMAGE = {"mark3dgs", "api"}
"""Their health check is the image's."""


def containers() -> dict[str, dict[str, Any]]:
    found = {}
    for path in sorted((ROOT / "docker").glob("compose*.yaml")):
        services = yaml.safe_load(path.read_text())["services"]
        found |= {f"{path.name}: {name}": settings for name, settings in services.items()}
    return found


@pytest.mark.parametrize("name", containers())
def test_limits_and_health(name: str) -> None:
    settings, service = containers()[name], name.split(": ")[1]
    assert settings["mem_limit"]
    assert settings["pids_limit"] <= 1024
    assert settings["logging"]["options"].keys() == {"max-size", "max-file"}
    assert "no-new-privileges:true" in settings["security_opt"]
    assert service == "bucket" or settings["restart"] == "unless-stopped"
    if service in OF_THE_IMAGE:
        assert "\nHEALTHCHECK " in (ROOT / "docker" / "Dockerfile").read_text()
        assert "healthcheck" not in settings
    else:
        assert service in SEEN_OTHERWISE or settings["healthcheck"]["test"]


def test_the_image_reads_every_format_and_its_packages_are_pinned() -> None:
    (extras,) = re.findall(r'^ARG EXTRAS="(.+)"$', (ROOT / "docker" / "Dockerfile").read_text(), re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    wanted = [*project["dependencies"], *(each for extra in extras.split() for each in optional[extra])]
    names = {re.split(r"[\[<>=;! ]", each)[0] for each in wanted}
    assert ("usd-core" in names) == any(kind.load for kind in KINDS), "OpenUSD alone needs an extra"
    pinned = {
        line.partition("==")[0].lower().replace("_", "-")
        for line in (ROOT / ".ci" / "constraints.txt").read_text().splitlines()
    }
    assert names <= pinned
