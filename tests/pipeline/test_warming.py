from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from engine.pipeline.warming import Work, warm_up


@pytest.mark.parametrize("work", ["embed", "model", "pictures", "everything"])
def test_every_kind_of_work_is_made_ready_and_reports_progress(work: Work) -> None:
    seen: list[float] = []
    warm_up(work, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert len(seen) > 1


WORKS = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from engine.formats import read_model
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import profile
from engine.pipeline.sealing import open_record
from engine.pipeline.verification import verify_images, verify_model
from engine.pipeline.warming import warm_up
from engine.raster import render
from engine.registration.sketch import SuspectIndex, make_sketch
from engine.sim.attacks import model_attack
from engine.watermark.keys import OwnerKey

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("engine.")]
    kernels = {kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}
    return {(kernel.py_func.__name__, signature) for kernel in kernels for signature in kernel.signatures}

loaded, key = read_model(sys.argv[1]), OwnerKey(bytes(range(32)))
for work in ("embed", "model", "pictures"):
    if work == "model":
        opened = open_record(made.record.to_bytes(key), key)
        moved = model_attack("similarity").apply(made.model, 4.0, rng=2)
        merged = model_attack("merge").apply(made.model, 0.5, rng=2, reading="as_code")
        picture = np.clip(render(made.model, opened.cameras[0]), 0.0, 1.0)
    warm_up(work)
    before = compiled()
    if work == "embed":
        config = profile("fast", landmark_views=4, views=2, view_size=128)
        made = embed(loaded.model, key, original_sha256=loaded.sha256, config=config)
    elif work == "model":
        for suspect in (made.model, moved, merged):
            verify_model(suspect, opened)
            SuspectIndex(suspect).resemblance(make_sketch(made.model))
    else:
        verify_images([picture], opened)
    print(work, sorted(name for name, _ in compiled() - before))
"""


def test_no_kernel_is_left_to_compile_when_the_work_begins() -> None:
    """In a fresh process: a user is told of the wait, and it comes once."""
    model = Path(__file__).parents[1] / "data" / "train_1000.ply"
    done = subprocess.run(
        [sys.executable, "-c", WORKS, str(model)], capture_output=True, text=True, check=False, cwd=model.parents[2]
    )
    assert done.stdout.splitlines() == ["embed []", "model []", "pictures []"], done.stdout + done.stderr
