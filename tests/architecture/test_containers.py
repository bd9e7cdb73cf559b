"""What every container of docker/compose*.yaml has: limits, logs that end, and a health check."""

from __future__ import annotations

from typing import Any

import pytest

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
