"""The registry: names, data, seeds, and that not one attack leaves its target as it was."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.adversaries.collusion import NEED_COPIES
from engine.lab.sim.attack import Attack
from engine.lab.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS, find_attack, image_attack, model_attack
from engine.model import Float32, GaussianModel

ATTRIBUTES = ("means", "log_scales", "quats", "opacity_logits", "sh")
NEEDS_FFMPEG = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="the ffmpeg command is not here")
ALL_READINGS = [
    pytest.param(
        attack,
        reading.label,
        id=f"{attack.name}-{reading.label}",
        marks=[NEEDS_FFMPEG] if attack.name in ("h264", "h265") else [],
    )
    for attack in (*MODEL_ATTACKS.values(), *IMAGE_ATTACKS.values())
    for reading in attack.readings
]


def arrays(target: GaussianModel | Float32) -> list[np.ndarray]:
    if isinstance(target, GaussianModel):
        return [getattr(target, name) for name in ATTRIBUTES]
    return [target]


def same(a: GaussianModel | Float32, b: GaussianModel | Float32) -> bool:
    return all(x.shape == y.shape and np.array_equal(x, y) for x, y in zip(arrays(a), arrays(b), strict=True))


@pytest.fixture
def options(request: pytest.FixtureRequest, attack: Attack) -> dict[str, object]:
    """What an attack needs beside its target."""
    if attack.name not in (*NEED_COPIES, "transplant"):
        return {}
    model = request.getfixturevalue("model")
    rng = np.random.default_rng(3)
    copies = [model.with_dc(model.sh[:, 0] + 0.1 * rng.standard_normal((len(model), 3))) for _ in range(2)]
    return {"others": copies} if attack.name in NEED_COPIES else {"source": copies[0]}


def test_each_stands_under_its_name() -> None:
    assert all(attack.name == name for name, attack in (MODEL_ATTACKS | IMAGE_ATTACKS).items())


@pytest.mark.parametrize(("attack", "label"), ALL_READINGS)
def test_data_are_complete(attack: Attack, label: str) -> None:
    reading = attack.reading(label)
    assert attack.kind in ("model", "image")
    assert "\n" not in attack.summary + reading.meaning
    assert attack.summary
    assert reading.meaning
    assert len(set(reading.grid)) == len(reading.grid) >= 3
    assert reading.default in reading.grid


@pytest.mark.parametrize(("attack", "label"), ALL_READINGS)
def test_changes_its_target_repeats_under_a_seed_and_is_pure(
    attack: Attack, label: str, target: GaussianModel | Float32, options: dict[str, object]
) -> None:
    if attack.name == "lattice" and isinstance(target, GaussianModel):  # a mark on a codebook: it rounds nothing else
        pairs = np.resize(np.float32([-2.01, -1.99, -3.01, -2.99]), target.log_scales.shape)
        target = target.with_(log_scales=pairs)
    before = [a.copy() for a in arrays(target)]
    first = attack.apply(target, rng=5, reading=label, **options)
    again = attack.apply(target, rng=np.random.default_rng(5), reading=label, **options)
    assert same(first, again)
    assert not same(first, target)
    for was, now, out in zip(before, arrays(target), arrays(first), strict=True):
        np.testing.assert_array_equal(was, now)
        assert np.isfinite(out).all()
        assert out.dtype == np.float32
    if attack.kind == "image":
        assert 0 <= first.min() <= first.max() <= 1


RANDOM = [
    "rotate",
    "translate",
    "similarity",
    "shuffle",
    "crop",
    "prune_random",
    "clone",
    "noise_means",
    "noise_colors",
    "noise_all",
    "merge_into",
    "bend",
    "inject",
    "noise_dc",
    "noise_opacity",
    "noise_position",
    "repaint",
    "evolve",
    "overwrite",
    "noise_image",
    "crop_image",
]


@pytest.mark.parametrize("attack", [find_attack(name) for name in RANDOM], ids=lambda a: a.name)
def test_another_seed_is_another_attack(attack: Attack, target: GaussianModel | Float32) -> None:
    assert not same(attack.apply(target, rng=5), attack.apply(target, rng=6))


@pytest.mark.parametrize(("attack", "label"), ALL_READINGS)
def test_every_strength_of_the_grid_runs(
    attack: Attack, label: str, target: GaussianModel | Float32, options: dict[str, object]
) -> None:
    for strength in attack.reading(label).grid:
        out = attack.apply(target, strength, rng=1, reading=label, **options)
        assert len(out) >= 1
        assert all(np.isfinite(a).all() for a in arrays(out))


def test_two_readings_where_the_field_has_two(image: Float32) -> None:
    both = {name for name, a in (MODEL_ATTACKS | IMAGE_ATTACKS).items() if len(a.readings) == 2}
    assert both == {
        "rotate",
        "translate",
        "crop",
        "clone",
        "merge",
        "noise_means",
        "noise_colors",
        "noise_image",
        "blur",
        "rotate_image",
        "scale_image",
        "crop_image",
    }
    noise = image_attack("noise_image")
    assert noise.apply(image) is not None
    assert (noise.reading("literal").default, noise.reading("as_code").default) == (0.1, 0.01)
    crop = image_attack("crop_image")
    area = image.shape[0] * image.shape[1]
    literal, as_code = crop.apply(image), crop.apply(image, reading="as_code")
    assert literal.shape[0] * literal.shape[1] / area == pytest.approx(0.6, abs=0.02)
    assert as_code.shape[0] * as_code.shape[1] / area == pytest.approx(0.16, abs=0.02)


def test_default_reading_is_the_first() -> None:
    attack = image_attack("crop_image")
    reading = attack.readings[0]
    assert attack.reading() is reading
    assert (attack.default, attack.grid, attack.meaning) == (reading.default, reading.grid, reading.meaning)


def test_unknown_names_are_refused_with_the_known_ones(model: GaussianModel) -> None:
    with pytest.raises(InputError, match=r"jpg.*rotate.*jpeg"):
        find_attack("jpg")
    with pytest.raises(InputError, match="no attack is called 'jpeg'"):
        model_attack("jpeg")
    with pytest.raises(InputError, match="no attack is called 'rotate'"):
        image_attack("rotate")
    with pytest.raises(InputError, match="no reading 'as_code'"):
        model_attack("scale").apply(model, reading="as_code")
