"""Rules on files: what no tracked file may mention, and what they may import."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.architecture.tree import ROOT, product_files, tracked_files

# A path that exists on one machine only. Kernel interfaces such as /proc are the same everywhere.
MACHINE_PATH = re.compile(r"(?<![\w./~$}-])/(?:work|tmp|home|root|Users|mnt|farm|srv|opt/(?:pypi|wheels))(?=/|\b)")
WINDOWS_PATH = re.compile(r"(?<![A-Za-z])[A-Z]:\\(?:Users|work|temp)", re.IGNORECASE)
# Where packages come from is the installer's setting, not the tree's.
REGISTRY = re.compile(
    r"(?:pypi\.(?:org)|(?:files\.)?python(?:hosted)\.org|download\.py(?:torch)\.org|registry\.npm(?:js)\.org"
    r"|npm(?:mirror)\.com|conda\.ana(?:conda)\.org|proxy\.golang\.(?:org)|--(?:extra-)?index(?:-)url"
    r"|\bgh(?:cr)\.io|registry\.hub\.do(?:cker))"
)
NOT_TEXT = {".ply", ".png", ".jpg", ".npz", ".sog", ".spz", ".splat", ".webp", ".glb", ".bin", ".m3r", ".record"}
VENDORED = {Path("service/web/docs/swagger-ui"), Path("service/web/viewer/supersplat"), Path("tests/service/web/axe")}
"""Folders of other people's files, kept as they came; a minified bundle holds closing tags that look like paths."""


def faults(text: str) -> list[str]:
    """Machine paths and registry hosts in a text."""
    return [m.group(0) for rule in (MACHINE_PATH, WINDOWS_PATH, REGISTRY) for m in rule.finditer(text)]


def test_rules_see_what_they_look_for() -> None:
    for bad in ("open('/wor" + "k/a')", "cd /tm" + "p", "see /hom" + "e/x", "C:" + "\\Users\\a", "pypi" + ".org"):
        assert faults(bad), bad
    for good in ("/proc/self/status", "a/work/b", "$HOME/work", "https://host/tmp", "./tmp/x", "/v1/models"):
        assert not faults(good), good


def test_no_machine_paths_and_no_registry_hosts() -> None:
    found = {}
    for path in tracked_files():
        if path.suffix in NOT_TEXT or path.parent in VENDORED:
            continue
        try:
            text = (ROOT / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:  # a binary golden file
            continue
        bad = faults(text)
        if path.parts[0] == "docker" or path.parts[:2] == ("tests", "docker"):
            bad = [
                fault for fault in bad if not MACHINE_PATH.match(fault)
            ]  # paths in a container are everywhere the same
        if bad:
            found[str(path)] = bad
    assert not found


def test_every_package_is_a_package() -> None:
    folders = {folder for path in product_files() for folder in path.parents if folder != Path(".")}
    assert not [str(folder) for folder in folders if not (ROOT / folder / "__init__.py").is_file()]


def test_imports_go_only_to_earlier_floors() -> None:
    pytest.importorskip("importlinter")
    code = "import sys; from importlinter.cli import lint_imports_command as run; sys.argv = ['lint']; run()"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout
