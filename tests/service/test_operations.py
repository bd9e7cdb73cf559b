"""docs/OPERATIONS.md: its commands run as written, in their order, and what it says to watch is there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

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
