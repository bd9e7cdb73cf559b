"""docs/OPERATIONS.md: its commands run as written, in their order, and what it says to watch is there."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml

from service.settings import Settings
from tests.service import serving
from tests.service.serving import ROOT

PAGE = (ROOT / "docs" / "OPERATIONS.md").read_text()
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)


def run(commands: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """In a shell that stops at the first command that fails."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MARK3DGS_")} | {"PATH": path}
    shell = ["bash", "-euo", "pipefail", "-c", commands]
    return subprocess.run(shell, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_manifest_fits_kubernetes_and_the_service() -> None:
    """docker/kubernetes.yaml: what it sets, probes and mounts is there. Against Kubernetes' own schemas where the
    package kubernetes-validate is installed, which the project does not need otherwise."""
    manifests = list(yaml.safe_load_all((ROOT / "docker" / "kubernetes.yaml").read_text()))
    if find_spec("kubernetes_validate"):
        import kubernetes_validate

        for manifest in manifests:
            kubernetes_validate.validate(manifest, kubernetes_validate.latest_version(), strict=True)
    by_kind: dict[str, list[Any]] = {}
    for manifest in manifests:
        by_kind.setdefault(manifest["kind"], []).append(manifest)
    variables = by_kind["ConfigMap"][0]["data"]
    known = {f"MARK3DGS_{name.upper()}" for name in Settings.model_fields}
    of_files = re.search(r"for name in (.*); do", (ROOT / "docker" / "entrypoint.sh").read_text())
    assert of_files
    known |= {f"{name}_FILE" for name in of_files[1].split()} | {"AWS_REGION"}
    assert variables.keys() <= known
    made = set(re.findall(r"^secret (\w+) ", (ROOT / "docker" / "secrets.sh").read_text(), re.MULTILINE))
    assert {Path(value).name for name, value in variables.items() if name.endswith("_FILE")} <= made
    paths = json.loads((ROOT / "openapi" / "openapi.json").read_text())["paths"]
    probed = set()
    for deployment in by_kind["Deployment"]:
        pod = deployment["spec"]["template"]
        assert deployment["spec"]["selector"]["matchLabels"] == pod["metadata"]["labels"]
        (container,) = pod["spec"]["containers"]
        command = [sys.executable, "-m", "service.cli", *container["args"], "--help"]
        assert subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode == 0
        volumes = {volume["name"] for volume in pod["spec"]["volumes"]}
        assert {mount["name"] for mount in container["volumeMounts"]} == volumes
        assert container["resources"]["limits"]["memory"]
        probed |= {probe["httpGet"]["path"] for name, probe in container.items() if name.endswith("Probe")}
    assert probed == {"/healthz", "/readyz"}
    assert probed <= paths.keys()
    (service,) = by_kind["Service"]
    assert service["spec"]["selector"] == by_kind["Deployment"][0]["spec"]["selector"]["matchLabels"]


@pytest.mark.long
def test_commands_run_as_written(tmp_path: Path) -> None:
    """Those that want no running service first; the others beside one."""
    install, backup, keyless, keys, watch = BLOCKS
    done = run(install, tmp_path)
    assert done.returncode == 0, done.stderr
    (tmp_path / "data").symlink_to(tmp_path / "mark3dgs-data")
    served = serving.start(tmp_path, api_key=(tmp_path / "mark3dgs-data" / "admin.key").read_text().strip())
    try:
        for block in (backup, keyless, watch):
            done = run(block.replace("http://127.0.0.1:8000", served.address), tmp_path)
            assert done.returncode == 0, block + done.stdout + done.stderr
    finally:
        served.stop()
    known = set(re.findall(r"^(mark3dgs_\w+)[{ ]", done.stdout, re.MULTILINE))
    assert known, done.stdout
    assert set(re.findall(r"`(mark3dgs_[a-z_]+)", PAGE)) - {"mark3dgs_jobs"} == known - {"mark3dgs_jobs"}
    assert run("MARK3DGS_DATA_DIR=keyless mark3dgs apikey list", tmp_path).returncode == 0
    done = run(keys, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "shop" in done.stdout
