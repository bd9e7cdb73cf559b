from __future__ import annotations

import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from engine.flows.warmup import kernel_warmup as warming
from engine.flows.warmup.kernel_warmup import Work, expected_seconds, warm_up
from engine.flows.warmup.warmup_steps import STEPS, Step
from engine.kernels import machine_code as native


@pytest.mark.parametrize("work", ["embed", "model", "pictures", "main", "everything"])
def test_every_kind_of_work_is_made_ready_and_reports_progress(work: Work) -> None:
    seen: list[float] = []
    warm_up(work, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert len(seen) > 1


@pytest.fixture
def helped(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The steps that helpers were called for; they do nothing."""
    steps: list[str] = []
    monkeypatch.setattr(subprocess, "Popen", MagicMock())
    monkeypatch.setattr(warming, "_ask", lambda program, step: steps.append(step))
    return steps


def small_steps(monkeypatch: pytest.MonkeyPatch, **steps: Callable[[], None]) -> None:
    table = {name: Step(run, 1.0, ("embed",)) for name, run in steps.items()}
    monkeypatch.setattr(warming, "steps_of", lambda work: table)


def test_a_missing_kernel_calls_helpers_and_what_they_did_is_loaded(
    monkeypatch: pytest.MonkeyPatch, helped: list[str]
) -> None:
    ran, fractions = list[str](), list[float]()

    def compiling() -> None:
        native.announce()
        deadline = time.monotonic() + 20.0
        while not helped and time.monotonic() < deadline:
            time.sleep(0.01)
        ran.append("first")

    small_steps(monkeypatch, first=compiling, second=lambda: ran.append("second"))
    said: list[str] = []
    warm_up("embed", fractions.append, processes=2, compiling=lambda: said.append("compiling"))
    assert said == ["compiling"]
    assert helped == ["second"]
    assert ran == ["first", "second"]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_no_helper_is_called_where_every_kernel_is_there(monkeypatch: pytest.MonkeyPatch, helped: list[str]) -> None:
    ran = list[str]()
    small_steps(monkeypatch, first=lambda: ran.append("first"), second=lambda: ran.append("second"))
    said: list[str] = []
    warm_up("embed", processes=4, compiling=lambda: said.append("compiling"))
    assert (helped, ran, said) == ([], ["first", "second"], [])


def test_loading_ends_when_it_is_enough_and_compiling_does_not(
    monkeypatch: pytest.MonkeyPatch, helped: list[str]
) -> None:
    ran = list[str]()
    small_steps(monkeypatch, first=lambda: ran.append("first"), second=lambda: ran.append("second"))
    warm_up("embed", enough=lambda: bool(ran))
    assert ran == ["first"]

    ran.clear()
    small_steps(monkeypatch, first=lambda: ran.append(str(native.announce())), second=lambda: None)
    fractions = list[float]()
    warm_up("embed", fractions.append, processes=1, enough=lambda: bool(ran))
    assert fractions[-1] == 1.0


def test_a_step_waits_for_those_with_the_same_kernels() -> None:
    steps = {
        name: Step(lambda: None, 1.0, ("embed",), after) for name, after in {"a": (), "b": (), "c": ("a",)}.items()
    }
    plan = warming._Plan(steps, lambda fraction: None)
    assert [plan.take(), plan.take()] == ["a", "b"]
    taken: list[str | None] = []
    waiting = threading.Thread(target=lambda: taken.append(plan.take()), daemon=True)
    waiting.start()
    plan.finish("b")
    waiting.join(0.2)
    assert taken == []
    plan.finish("a")
    waiting.join(20.0)
    assert taken == ["c"]
    assert plan.take() is None


def test_steps_can_be_made_ready_by_a_program_of_its_own() -> None:
    names = "cells\ncolors\n"
    done = subprocess.run(
        [sys.executable, "-m", "engine.flows.warmup.warmup_steps"],
        input=names,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, names), done.stderr


def test_a_helper_that_ends_is_no_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever called compiles what the helper has not."""
    ran = list[str]()

    def compiling() -> None:
        native.announce()
        time.sleep(0.2)

    small_steps(monkeypatch, first=compiling, second=lambda: ran.append("second"), third=lambda: ran.append("third"))
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    warm_up("embed", processes=2)
    assert sorted(ran) == ["second", "third"]


def test_steps_come_after_those_they_name_and_the_wait_is_foretold() -> None:
    names = list(STEPS)
    for name, step in STEPS.items():
        assert all(names.index(before) < names.index(name) for before in step.after), name
    assert 0.0 < expected_seconds("embed") < expected_seconds("main") <= expected_seconds("everything")


WORKS = """
import sys
import numpy as np
from engine.formats import read_model
from engine.kernels.jit import Kernel
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import verify_images, verify_model
from engine.flows.warmup.kernel_warmup import warm_up
from engine.raster import render
from engine.records.reference import decode_reference, encode_reference
from engine.registration.sketch import SuspectIndex, make_sketch
from engine.lab.sim.attacks import model_attack
from engine.watermark.keys import OwnerKey

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("engine.")]
    kernels = {kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Kernel)}
    return {(kernel.__name__, signature) for kernel in kernels for signature in kernel.signatures}

loaded, key = read_model(sys.argv[1]), OwnerKey(bytes(range(32)))
for work in ("embed", "model", "pictures"):
    if work == "model":
        opened = open_record(made.record.to_bytes(key), key)
        moved = model_attack("similarity").apply(made.model, 4.0, rng=2)
        merged = model_attack("merge").apply(made.model, 0.5, rng=2, reading="as_code")
        picture = np.rint(255.0 * np.clip(render(made.model, opened.cameras[0]), 0.0, 1.0)) / np.float32(255.0)
    warm_up(work)
    before = compiled()
    if work == "embed":
        config = profile("fast", landmark_views=4, views=2, view_size=128)
        made = embed(loaded.model, key, original_sha256=loaded.sha256, config=config)
    elif work == "model":
        for suspect in (made.model, moved, merged):
            verify_model(suspect, opened)
            SuspectIndex(suspect).resemblance(make_sketch(made.model))
        arrays = encode_reference(made.model.with_(sh=made.model.sh[:, :1]))
        for array in arrays.values():
            array.flags.writeable = False
        decode_reference(arrays)
    else:
        verify_images([picture], opened)
        assert verify_images([picture], opened, cameras=opened.cameras[:1]).claim.z > 1.0
    print(work, sorted(name for name, _ in compiled() - before))
"""


def test_no_kernel_is_left_to_compile_when_the_work_begins() -> None:
    """In a fresh process: the wait is announced, and it comes once."""
    model = Path(__file__).parents[1] / "data" / "train_1000.ply"
    done = subprocess.run(
        [sys.executable, "-c", WORKS, str(model)], capture_output=True, text=True, check=False, cwd=model.parents[2]
    )
    assert done.stdout.splitlines() == ["embed []", "model []", "pictures []"], done.stdout + done.stderr
