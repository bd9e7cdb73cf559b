"""The settings of Table 5: what the attacker sees, what moves, and that it does what fine-tuning does."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.training import stops_until
from engine.lab.sim.adversaries.retraining import SETTINGS, fine_tune, fine_tune_stages, pictures_of
from engine.model import GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render

SIZE = 48


@pytest.fixture(scope="module")
def marked(model: GaussianModel) -> GaussianModel:
    """As if marked: DC moved by chips."""
    signs = np.random.default_rng(1).choice([-1.0, 1.0], model.sh[:, 0].shape)
    return model.with_dc(model.sh[:, 0] + 0.05 * signs.astype(np.float32))


def test_settings_are_the_papers() -> None:
    four = [(s.clean_images, s.pose_key) for s in SETTINGS.values()]
    assert four == [(False, True), (False, False), (True, True), (True, False)]


@pytest.mark.parametrize("name", list(SETTINGS))
def test_what_the_attacker_sees(name: str, model: GaussianModel, marked: GaussianModel) -> None:
    setting = SETTINGS[name]
    key_views = make_rig(model, 3, 100, 100)
    cameras, images = pictures_of(setting, model, marked, key_views, size=SIZE)
    assert len(cameras) == 3
    own = [np.allclose(c.viewmat, k.viewmat) for c, k in zip(cameras, key_views, strict=True)]
    assert own == [setting.pose_key] * 3
    for camera, image in zip(cameras, images, strict=True):
        assert image.shape == (SIZE, SIZE, 3)
        clean, stolen = (np.clip(render(m, camera), 0, 1) for m in (model, marked))
        assert psnr(clean, stolen) < 50
        if setting.clean_images:
            np.testing.assert_array_equal(image, clean)
        else:
            assert 0 < np.abs(image - stolen).max() <= 0.5 / 255 + 1e-6
            np.testing.assert_allclose(image * 255, np.round(image * 255), atol=1e-3)


def test_own_views_follow_the_seed(model: GaussianModel) -> None:
    views = [
        pictures_of(SETTINGS["clean"], model, model, make_rig(model, 2, 64, 64), size=SIZE, seed=seed)[0][0]
        for seed in (0, 0, 1)
    ]
    np.testing.assert_array_equal(views[0].viewmat, views[1].viewmat)
    assert np.abs(views[0].viewmat - views[2].viewmat).max() > 0.01


@pytest.mark.parametrize("trained", ["all", "colors"])
def test_clean_images_pull_the_model_back(trained: str, model: GaussianModel, marked: GaussianModel) -> None:
    cameras, images = pictures_of(SETTINGS["clean+key"], model, marked, make_rig(model, 3, 64, 64), size=SIZE)
    tuned = fine_tune(marked, cameras, images, 15, trained=trained)
    gain = [
        psnr(image, render(tuned, c)) - psnr(image, render(marked, c)) for c, image in zip(cameras, images, strict=True)
    ]
    assert min(gain) > 3
    assert len(tuned) == len(marked)
    moved = {
        name: np.abs(getattr(tuned, name) - getattr(marked, name)).max() > 1e-5
        for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
    }
    assert moved == {name: trained == "all" or name == "sh" for name in moved}


def test_own_pictures_move_it_too_but_not_back(model: GaussianModel, marked: GaussianModel) -> None:
    cameras, images = pictures_of(SETTINGS["key"], model, marked, make_rig(model, 3, 64, 64), size=SIZE)
    tuned = fine_tune(marked, cameras, images, 10)
    assert np.abs(tuned.sh - marked.sh).max() > 1e-3
    step = (tuned.sh - marked.sh)[:, 0].ravel()
    mark = (model.sh - marked.sh)[:, 0].ravel()
    assert abs(np.corrcoef(step, mark)[0, 1]) < 0.15


def test_stages_are_one_training(model: GaussianModel, marked: GaussianModel) -> None:
    cameras, images = pictures_of(SETTINGS["clean"], model, marked, make_rig(model, 2, 64, 64), size=SIZE)
    stages = dict(fine_tune_stages(marked, cameras, images, [0, 2, 5]))
    assert list(stages) == [0, 2, 5]
    assert stages[0] is marked
    assert stages[5].sh.tobytes() == fine_tune(marked, cameras, images, 5).sh.tobytes()
    assert stages[2].sh.tobytes() != stages[5].sh.tobytes()


def test_stops() -> None:
    assert stops_until(500) == (0, 100, 300, 500)
    assert stops_until(40) == (0, 40)
    assert stops_until(1000) == (0, 100, 300, 500, 1000)


@pytest.mark.parametrize("epochs", [[], [0], [3, 2], [-1, 3]])
def test_refused_epochs(epochs: list[int], model: GaussianModel) -> None:
    cameras, images = pictures_of(SETTINGS["clean"], model, model, make_rig(model, 2, 64, 64), size=SIZE)
    with pytest.raises(InputError, match="epochs must rise"):
        list(fine_tune_stages(model, cameras, images, epochs))
