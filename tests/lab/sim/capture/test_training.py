"""Training: it learns its images, in every setting, and the same way every time."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.capture.capture_kernels import kernels_from_points
from engine.lab.sim.capture.trainer import NAMES, DensifyConfig, TrainConfig, Trainer, cameras_extent, train
from engine.model import GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.raster import render
from tests.lab.sim.capture.scenes import orbit, photos, shell
from tests.threads import with_one_and_two_threads

TRUTH = shell()
CAMERAS = orbit(8)
PHOTOS = photos(TRUTH, CAMERAS)
FIXED = TrainConfig(steps=40, sh_degree=None, densify=None)


def quality(model: GaussianModel, which: int) -> float:
    return psnr(render(model, CAMERAS[which]), PHOTOS[which])


def points(seed: int = 0, count: int = 150) -> GaussianModel:
    """What a reconstruction would know: some centers, a little off, and the colors there."""
    rng = np.random.default_rng(seed)
    chosen = TRUTH.take(rng.choice(len(TRUTH), count, replace=False))
    shades = np.clip(0.5 + 0.282 * chosen.sh[:, 0], 0, 1)
    return kernels_from_points(chosen.means + rng.normal(0, 0.03, chosen.means.shape), shades)


def same(a: GaussianModel, b: GaussianModel) -> bool:
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in NAMES)


def test_a_view_it_never_saw() -> None:
    """From points to 22 dB on a photo held out, with densification and an opacity reset on the way."""
    start = points()
    config = TrainConfig(steps=350, sh_degree=1, densify=DensifyConfig(first=0.1, every=20, reset=0.5, most=1000))
    used = [k for k in range(8) if k != 3]
    model = train(start, [CAMERAS[k] for k in used], [PHOTOS[k] for k in used], config)
    assert len(start) < len(model) <= 1000
    assert model.sh_degree == 1
    np.testing.assert_allclose(np.linalg.norm(model.quats, axis=1), 1.0, atol=1e-5)
    assert quality(model, 3) > quality(start, 3) + 5
    assert quality(model, 3) > 22


@pytest.mark.parametrize("name", NAMES)
def test_every_parameter_is_learnt(name: str) -> None:
    """One attribute spoilt, all trained: that attribute moves, and the photos fit better."""
    rng = np.random.default_rng(1)
    noise = {"means": 0.05, "log_scales": 0.4, "quats": 0.5, "opacity_logits": 1.5, "sh": 0.3}[name]
    good = getattr(TRUTH, name)
    spoilt = TRUTH.with_(**{name: good + rng.normal(0, noise, good.shape).astype(np.float32)})
    tuned = train(spoilt, CAMERAS, PHOTOS, TrainConfig(steps=80, sh_degree=None, densify=None))
    assert np.abs(getattr(tuned, name) - getattr(spoilt, name)).max() > 1e-3
    before, after = (np.mean([quality(m, k) for k in range(8)]) for m in (spoilt, tuned))
    assert after > before + 2


def test_colors_alone() -> None:
    grey = TRUTH.with_(sh=np.zeros_like(TRUTH.sh))
    config = TrainConfig(steps=60, trained="colors", sh_degree=None, color_rate=0.05)
    tuned = train(grey, CAMERAS, PHOTOS, config)
    assert all((getattr(tuned, name) == getattr(grey, name)).all() for name in NAMES if name not in ("sh", "quats"))
    np.testing.assert_allclose(tuned.quats, grey.quats, atol=1e-6)
    assert quality(tuned, 0) > quality(grey, 0) + 10


def test_sh_degrees_join_one_by_one() -> None:
    config = TrainConfig(steps=40, sh_degree=2, sh_every=0.25, densify=None)
    trainer = Trainer(points(), CAMERAS, PHOTOS, config)
    degrees = []
    for _ in range(40):
        trainer.step()
        degrees.append(trainer.parameters.model.sh_degree)
    assert degrees == [0] * 9 + [1] * 10 + [2] * 21
    assert np.abs(trainer.parameters.model.sh[:, 4:]).max() > 0


def test_rates_fall_from_first_to_last() -> None:
    trainer = Trainer(TRUTH, CAMERAS, PHOTOS, FIXED)
    trainer.done = 1
    first = trainer._rates()
    trainer.done = 40
    last = trainer._rates()
    assert first["means"] == pytest.approx(1.6e-4 * trainer.extent)
    assert last["means"] == pytest.approx(1.6e-6 * trainer.extent)
    assert {k: v for k, v in first.items() if k != "means"} == {k: v for k, v in last.items() if k != "means"}


def test_the_same_bytes_from_the_same_seed_on_any_thread_count() -> None:
    config = TrainConfig(steps=60, sh_degree=1, background="random", densify=DensifyConfig(first=0.1, every=15))
    one, two = with_one_and_two_threads(lambda: train(points(), CAMERAS, PHOTOS, config))
    assert same(one, two)
    other = TrainConfig(steps=60, sh_degree=1, background="random", densify=DensifyConfig(first=0.1, every=15), seed=1)
    assert not same(two, train(points(), CAMERAS, PHOTOS, other))


def test_a_pickled_training_goes_on_where_it_was() -> None:
    straight = train(points(), CAMERAS, PHOTOS, FIXED)
    trainer = Trainer(points(), CAMERAS, PHOTOS, FIXED)
    reports: list[float] = []
    trainer.run(reports.append, until=17)
    assert trainer.done == 17
    assert reports[-1] == pytest.approx(17 / 40)
    assert same(pickle.loads(pickle.dumps(trainer)).run(), straight)


def test_nothing_hides_in_a_random_background() -> None:
    """Faint Gaussians over black photos: on black they may stay faint, on random colors they must cover."""
    faint = TRUTH.with_(opacity_logits=np.full(len(TRUTH), -3.0, np.float32), sh=np.full_like(TRUTH.sh, -1.772))
    black = [np.zeros_like(photo) for photo in PHOTOS]
    opacities = []
    for behind in (0.0, "random"):
        config = TrainConfig(steps=40, sh_degree=None, densify=None, background=behind)
        opacities.append(train(faint, CAMERAS, black, config).opacities.mean())
    assert opacities[1] > 2 * opacities[0]


def test_extent() -> None:
    up = (0.0, -1.0, 0.0)
    pair = [look_at((x, 0.0, 0.0), (0.0, 0.0, 5.0), up, 10.0, 16, 16) for x in (-1.0, 3.0)]
    assert cameras_extent(pair) == pytest.approx(2.2)
    assert cameras_extent(pair[:1]) == 1.0


def test_the_model_given_stays_as_it_is() -> None:
    start = points()
    before = {name: getattr(start, name).copy() for name in NAMES}
    train(start, CAMERAS, PHOTOS, TrainConfig(steps=3))
    assert all((getattr(start, name) == before[name]).all() for name in NAMES)


def test_refusals() -> None:
    with pytest.raises(InputError, match="8 cameras for 7 pictures"):
        Trainer(TRUTH, CAMERAS, PHOTOS[:7])
    with pytest.raises(InputError, match="picture 1 has shape"):
        Trainer(TRUTH, CAMERAS[:2], [PHOTOS[0], PHOTOS[1][:-1]])
    with pytest.raises(InputError, match="is empty"):
        Trainer(TRUTH.take(np.arange(0)), CAMERAS, PHOTOS)


@pytest.mark.parametrize(
    "options", [{"steps": 0}, {"trained": "sh"}, {"sh_degree": 4}, {"opacity_rate": 0.0}, {"background": "sky"}]
)
def test_refused_settings(options: dict[str, object]) -> None:
    with pytest.raises(InputError):
        TrainConfig(**options)
