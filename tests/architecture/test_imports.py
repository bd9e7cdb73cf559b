"""Rules on imports: the package opens at once, and torch is loaded only by those who work with it."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys

import pytest

from tests.architecture.tree import ROOT, module_name, product_files

SECONDS = 0.5
"""Longest median time that `import mark3dgs` may keep a processor busy (a busy machine is not the package's fault)."""

RUN_BY_ALEMBIC = {"service.db.migrations.env"}
"""Works on a context that only Alembic makes."""

TORCH_MODULES = {"engine.flows.embed.distortions", "engine.flows.embed.refinement", "engine.lab.raster.autograd"}
"""Modules that are nothing without torch; everybody else imports them (or torch) inside a function."""

OPENING = """
import importlib, json, sys, time
start = time.process_time()
importlib.import_module(sys.argv[1])
seconds = time.process_time() - start
print(json.dumps([seconds, sorted({"torch", "numba", "cv2", "scipy", "skimage"} & set(sys.modules))]))
"""

EVERYTHING = """
import importlib, json, sys
blame = {}
for name in json.loads(sys.argv[1]):
    importlib.import_module(name)
    if "torch" in sys.modules and not blame:
        blame[name] = "torch"
print(json.dumps(blame))
"""


def run(code: str, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_package_opens_at_once_and_brings_nothing_heavy() -> None:
    runs = [json.loads(run(OPENING, "mark3dgs")) for _ in range(5)]
    assert statistics.median(seconds for seconds, _ in runs) <= SECONDS
    assert all(heavy == [] for _, heavy in runs)


def test_an_api_process_brings_nothing_that_works_on_models() -> None:
    """It stays at half the memory: all of that is done in processes of their own."""
    assert json.loads(run(OPENING, "service.app"))[1] == []


@pytest.mark.long
def test_only_torch_modules_import_torch_when_loaded() -> None:
    others = sorted({module_name(path) for path in product_files()} - TORCH_MODULES - RUN_BY_ALEMBIC)
    assert len(others) > 20
    assert json.loads(run(EVERYTHING, json.dumps(others))) == {}


LATER = """
import importlib, sys
importlib.import_module(sys.argv[1])
late = {"numba", "scipy.spatial", "scipy.special", "scipy.sparse", "scipy.ndimage", "scipy.fft", "cv2", "torch"}
print(sorted(late & set(sys.modules)))
"""


def test_flows_open_without_what_only_some_of_their_work_needs() -> None:
    """Each costs every command a tenth to a quarter of a second; together they were half of what imports took."""
    for module in ("engine.flows.embed.embedding", "engine.flows.verify.search", "engine.flows.trace.tracing"):
        assert run(LATER, module) == "[]\n", module
