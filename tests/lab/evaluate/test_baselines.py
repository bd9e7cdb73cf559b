"""Baselines: each reads its own mark, keeps the wanted fidelity, and fails where its class fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.baselines.method import Kept
from engine.lab.evaluate.baselines.methods import METHODS
from engine.lab.evaluate.baselines.picture_marks import FittedPictures, decode, encode
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.evaluate.published import read_published
from engine.lab.sim.attacks import model_attack
from engine.model import Camera, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.watermark.messages import Signs, derive_message

PLANT = str(Path(__file__).parents[2] / "data" / "plant.splat")
KEY = bench_key(5)
MESSAGE = derive_message(KEY, 32, b"test")


@pytest.fixture(scope="module")
def cameras(plant: GaussianModel) -> list[Camera]:
    return make_rig(plant, 2, 300, 300)


@pytest.fixture(scope="module")
def marked(plant: GaussianModel, cameras: list[Camera]) -> Callable[[str], tuple[GaussianModel, Kept]]:
    made = {name: METHODS[name].embed(plant, KEY, MESSAGE, 47.0, cameras) for name in ("qim", "spread")}
    return made.__getitem__


def right(scores: np.ndarray | None, message: Signs = MESSAGE) -> int:
    assert scores is not None
    return int((np.sign(scores) == message).sum())


@pytest.mark.parametrize("name", ["qim", "spread"])
def test_a_mark_is_read_at_the_wanted_fidelity(
    name: str, plant: GaussianModel, cameras: list[Camera], marked: Callable[[str], tuple[GaussianModel, Kept]]
) -> None:
    model, kept = marked(name)
    worst = min(psnr(render(plant, camera), render(model, camera)) for camera in cameras)
    assert 47.0 <= worst <= 47.06
    assert right(METHODS[name].read_model(model, kept)) == 32
    wrong = [right(METHODS[name].read_model(model, replace(kept, key=bench_key(k)))) for k in range(20, 30)]
    assert 12 <= np.mean(wrong) <= 20
    assert METHODS[name].read_picture(render(model, cameras[0]), kept) is None
    again, _ = METHODS[name].embed(plant, KEY, MESSAGE, 47.0, cameras)
    np.testing.assert_array_equal(again.sh, model.sh)


def test_each_class_fails_where_it_must(marked: Callable[[str], tuple[GaussianModel, Kept]]) -> None:
    for name, survives, fails in (
        ("qim", ("shuffle", 1.0), ("rotate", 30.0)),
        ("spread", ("noise_dc", 0.02), ("shuffle", 1.0)),
    ):
        model, kept = marked(name)
        for (attack, strength), kept_bits in ((survives, True), (fails, False)):
            suspect = model_attack(attack).apply(model, strength)
            assert (right(METHODS[name].read_model(suspect, kept)) >= 31) == kept_bits, (name, attack)


def test_spread_spectrum_reads_a_file_cut_at_its_end(marked: Callable[[str], tuple[GaussianModel, Kept]]) -> None:
    model, kept = marked("spread")
    shorter = model.take(np.arange(round(0.9 * len(model))))
    assert right(METHODS["spread"].read_model(shorter, kept)) >= 31
    longer = model.take(np.concatenate([np.arange(len(model)), np.arange(50)]))
    assert right(METHODS["spread"].read_model(longer, kept)) == 32


def test_the_picture_mark_reads_its_picture(plant: GaussianModel, cameras: list[Camera]) -> None:
    picture = np.clip(render(plant, cameras[0]), 0, 1)
    written = encode(picture, KEY, MESSAGE)
    assert 34 < psnr(picture, written) < 46
    assert right(decode(written, KEY, 32)) == 32
    assert right(decode(written, bench_key(6), 32)) < 26
    assert right(decode(picture, KEY, 32)) < 26
    assert (written[picture.max(axis=2) == 0] == 0).all()
    assert decode(picture[:5, :5], KEY, 32).tolist() == [0.0] * 32


def test_a_fitted_model_carries_some_of_the_picture_mark(plant: GaussianModel, cameras: list[Camera]) -> None:
    method = replace(METHODS["dct"], views=2, size=200, epochs=6, read_views=2)  # type: ignore[type-var]
    assert isinstance(method, FittedPictures)
    model, kept = method.embed(plant, KEY, MESSAGE, 40.0, cameras)
    assert 40.0 <= min(psnr(render(plant, c), render(model, c)) for c in cameras) <= 40.06
    scores = method.read_model(model, kept)
    assert float((scores * MESSAGE).mean()) > 1.0  # two views agree with each other; twelve no longer do
    np.testing.assert_array_equal(model.means, plant.means)


def test_published_numbers_have_their_conditions() -> None:
    points = read_published()
    wanted = {"GS-Hider", "WATER-GS", "GaussianMarker", "GuardSplat", "3D-GSW", "W2M", "FlyMark", "NGS-Marker"}
    assert wanted <= {point.method for point in points}
    assert all(point.source and point.hardware and np.isfinite(point.value) for point in points)
    assert all(0 <= point.value <= 100 for point in points if point.what == "bit accuracy")
    keys = [(point.method, point.what, point.conditions) for point in points]
    assert len(set(keys)) == len(keys)
    assert "published, other hardware, blind" in next(p.label for p in points if p.method == "GuardSplat")
