"""One marked model, made by the task itself, and a way to ask the tasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.model import Float32
from engine.raster import render
from engine.usecases.files import write_picture
from service.work.tasks import TASKS
from tests.scenes import sparse_plant

DATA = Path(__file__).parents[2] / "data"
FOREIGN = DATA / "train_1000.ply"
KEY = "11" * 16 + "22" * 16

Ask = Callable[..., dict[str, Any]]


def silent(stage: str, fraction: float) -> None:
    """Nobody looks at the progress."""


@dataclass(frozen=True)
class Marked:
    """Files of one embedding, and what the task replied."""

    folder: Path
    original: Path
    reply: dict[str, Any]
    stages: list[tuple[str, float]]  # as it went

    def path(self, name: str) -> Path:
        return self.folder / self.reply["files"][name]

    def candidate(self, asset: str = "plant", **changes: str | Path) -> dict[str, Any]:
        plain = {"asset": asset, "original": asset, "record": self.path("record"), "key": KEY}
        return {name: str(value) for name, value in (plain | changes).items()}


@pytest.fixture(scope="session")
def marked(tmp_path_factory: pytest.TempPathFactory) -> Marked:
    """The shipped scene, thinned out, marked with the fast profile."""
    folder = tmp_path_factory.mktemp("marked")
    original = folder / "plant.splat"
    original.write_bytes(sparse_plant())
    request = {
        "model": str(original),
        "key": KEY,
        "message": "c0ffee42",
        "bits": None,
        "profile": "fast",
        "psnr": None,
        "budget": None,
        "output": None,
        "format": "ply",
        "copy": "acme",
        "cameras": None,
        "spz_frame": "auto",
        "registered_at": "2026-01-02T03:04:05+00:00",
    }
    stages: list[tuple[str, float]] = []
    reply = TASKS["embed"](request, folder, lambda stage, fraction: stages.append((stage, fraction)))
    return Marked(folder, original, reply, stages)


def shot_of(
    marked: Marked, folder: Path, behind: float = 0.0, change: Callable[[Float32], Float32] = lambda image: image
) -> Path:
    """A JPEG of the marked model from a camera of its own, before a grey, changed before it is stored."""
    model = read_model(marked.path("model")).model
    camera = make_rig(model, 1, 900, 640, jitter=np.random.default_rng(3).random((1, 4)))[0]
    path = folder / "shot.jpg"
    write_picture(change(np.clip(render(model, camera, behind), 0, 1)), path, path, 85)
    return path


@pytest.fixture
def verify(marked: Marked, tmp_path: Path) -> Ask:
    """Ask the task `verify`; what is not said is the usual."""

    def ask(**request: Any) -> dict[str, Any]:
        usual = {
            "model": None,
            "images": [],
            "cameras": None,
            "spz_frame": "auto",
            "false_claim_rate": 1e-9,
            "route": "auto",
            "candidates": [marked.candidate()],
            "stop_at_first": True,
        }
        return TASKS["verify"](usual | request, tmp_path, silent)

    return ask


@pytest.fixture
def inspect(tmp_path: Path) -> Ask:
    """Ask the task `inspect`."""

    def ask(model: Path, **request: Any) -> dict[str, Any]:
        usual = {"model": str(model), "spz_frame": "auto"}
        return TASKS["inspect"](usual | request, tmp_path, silent)

    return ask


def checks(reply: dict[str, Any]) -> dict[str, bool | None]:
    """The outcome of each check."""
    return {check["code"]: check["ok"] for check in reply["checks"]}


@pytest.fixture(autouse=True)
def _small(small_renders: None) -> None:
    """How much renders say is the matter of tests/pipeline."""
