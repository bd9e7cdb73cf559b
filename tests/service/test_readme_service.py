"""Commands and programs of README.md, GUIDE.md and SERVICE.md, run as written against a running service, give
answers of the form that is shown."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from service.settings import Settings
from tests.service import serving
from tests.service.serving import ROOT

BLOCK = re.compile(r"```sh\n(?P<commands>.*?)```(?:\s*```json\n(?P<answer>.*?)```)?", re.DOTALL)


def form(value: Any) -> Any:
    """Names and kinds of values, without the values."""
    if isinstance(value, dict):
        return {name: form(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [form(entry) for entry in value[:1]]
    return "number" if isinstance(value, (int, float)) and not isinstance(value, bool) else type(value).__name__


@pytest.mark.long
def test_commands_run_as_written(tmp_path: Path) -> None:
    served = serving.start(tmp_path)
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    answers: dict[str, str] = {}
    try:
        blocks = [b for b in BLOCK.finditer((ROOT / "docs" / "GUIDE.md").read_text()) if "curl" in b["commands"]]
        assert len(blocks) == 5
        for block in blocks:
            commands = block["commands"].replace("http://127.0.0.1:8000", served.address)
            commands = commands.replace("mk_...", served.api_key)
            for name, value in answers.items():
                commands = re.sub(rf"(?m)^{name}=\S+", f"{name}={value}", commands)
            done = subprocess.run(
                ["bash", "-e", "-c", commands],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                env=os.environ | {"PATH": path, "MARK3DGS_API_KEY": served.api_key},
                check=False,
            )
            assert done.returncode == 0, commands + done.stdout + done.stderr
            if block["answer"] is not None:
                job = json.loads(done.stdout)
                assert form(job) == form(json.loads(block["answer"]))
                answers |= {"ASSET": job["result"]["asset_id"], "CLAIM": job["result"].get("claim_id", "")}
    finally:
        served.stop()
    assert (tmp_path / "report.html").read_text().startswith("<!doctype html>")


@pytest.mark.long
def test_the_clients_of_the_pages_run_as_written(tmp_path: Path) -> None:
    pages = {"README.md": "py", "docs/SERVICE.md": "python"}
    program = "".join(
        re.findall(rf"```{kind}\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)[0] for page, kind in pages.items()
    )
    served = serving.start(tmp_path)
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    path = f"{ROOT}{os.pathsep}{ROOT / 'service' / 'installed'}"
    environment = os.environ | {"MARK3DGS_API_KEY": served.api_key, "PYTHONPATH": path}
    program = program.replace("http://127.0.0.1:8000", served.address).replace("mk_...", served.api_key)
    command = [sys.executable, "-c", program]
    try:
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    finally:
        served.stop()
    assert done.returncode == 0, done.stdout + done.stderr
    first, second, _ = done.stdout.splitlines()
    assert re.fullmatch(r"Watermark found Bits\(string='[01]{32}', hex='[0-9a-f]{8}'\) \d+\.\d+", first), first
    assert second.startswith("marked -")
    assert done.stdout.endswith("not-found\n")
    assert (tmp_path / "report.html").read_text().startswith("<!doctype html>")


def test_every_setting_is_documented() -> None:
    text = (ROOT / "docs" / "SERVICE.md").read_text()
    for name, field in Settings.model_fields.items():
        row = next(line for line in text.splitlines() if line.startswith(f"| `MARK3DGS_{name.upper()}` |"))
        assert str(field.description) in row
