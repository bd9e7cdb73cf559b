"""What an attack refuses: strengths out of range or of the wrong kind, targets that are empty or no image."""

from __future__ import annotations

import re

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.attack import Attack, Reading
from engine.lab.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS, model_attack
from engine.model import Float32, GaussianModel

OUT_OF_RANGE = {
    "rotate": float("nan"),
    "scale": 0.0,
    "translate": float("inf"),
    "similarity": 0.9,
    "shuffle": 1.1,
    "crop": 0.0,
    "prune_random": 1.0,
    "prune_opacity": -0.1,
    "prune_low_impact": 1.0,
    "clone": 1.5,
    "merge": 0.0,
    "lod": 1.5,
    "noise_means": -1.0,
    "noise_colors": float("nan"),
    "noise_all": float("inf"),
    "drop_sh": 4,
    "quantize": 0,
    "merge_into": 0.0,
    "convert": "ksplat",
    "bend": float("nan"),
    "twist": float("inf"),
    "squash": 1.0,
    "jpeg": 0,
    "noise_image": -0.1,
    "blur": -1.0,
    "rotate_image": float("nan"),
    "scale_image": 0.0,
    "crop_image": 1.0,
    "brightness": -1.0,
    "inject": 1.5,
    "noise_dc": -0.1,
    "noise_opacity": float("nan"),
    "noise_position": -1.0,
    "quantize_colors": 0,
    "round_floats": 24,
    "bake_colors": 0,
    "smooth_colors": 0,
    "repaint": 1.1,
    "purify": 0.0,
    "evolve": 0.0,
    "overwrite": -3.0,
    "collude": "sum",
    "transplant": 0.0,
    "median": 4,
    "bilateral": 0.0,
    "denoise_nonlocal": -1.0,
    "denoise_wavelet": -0.1,
}


def test_all_that_are_refused_here_are_there() -> None:
    others = {"contrast", "saturation", "white_balance", "webp", "avif", "h264", "h265"}
    others |= {f"resize_{way}" for way in ("nearest", "bilinear", "area", "lanczos")}
    assert others | set(OUT_OF_RANGE) <= {*MODEL_ATTACKS, *IMAGE_ATTACKS}


def refused(attack: Attack) -> float | str:
    """A strength beyond the end of the range; of an attack without a word above, one that is none."""
    return OUT_OF_RANGE.get(attack.name, "none" if isinstance(attack.default, str) else float("nan"))


@pytest.mark.parametrize("attack", [*MODEL_ATTACKS.values(), *IMAGE_ATTACKS.values()], ids=lambda a: a.name)
def test_strength_out_of_range_is_an_input_error(attack: Attack, target: GaussianModel | Float32) -> None:
    with pytest.raises(InputError):
        attack.apply(target, refused(attack))


@pytest.mark.parametrize(
    ("within", "inside", "outside"),
    [
        ("[0, 1)", (0, 0.5), (-0.1, 1, float("nan"), float("inf"))),
        ("(0, 1]", (0.5, 1), (0, 1.1)),
        ("(0, inf)", (1e9,), (0, float("inf"))),
        ("(-inf, inf)", (-3, 3), (float("-inf"), float("nan"))),
        ("1..100", (1, 50.0, 100), (0, 101, 50.5, float("nan"))),
    ],
)
def test_ranges_of_strengths(within: str, inside: tuple[float, ...], outside: tuple[float, ...]) -> None:
    reading = Reading(lambda target, strength, rng: target, "share", 1.0, (), within)
    for strength in inside:
        assert reading.checked(strength) == strength
        assert isinstance(reading.checked(strength), int if ".." in within else float)
    words = "be a whole number from 1 to 100" if ".." in within else f"lie in {within}"
    for strength in outside:
        with pytest.raises(InputError, match="share must " + re.escape(words)):
            reading.checked(strength)


def test_strength_of_the_wrong_type_is_an_input_error(model: GaussianModel) -> None:
    with pytest.raises(InputError, match="degrees"):
        model_attack("rotate").apply(model, "much")
    with pytest.raises(InputError, match="format"):
        model_attack("convert").apply(model, 3.0)


@pytest.mark.parametrize("attack", [*MODEL_ATTACKS.values()], ids=lambda a: a.name)
def test_an_empty_model_is_an_input_error(attack: Attack, model: GaussianModel) -> None:
    with pytest.raises(InputError, match="empty"):
        attack.apply(model.take(np.arange(0)))


@pytest.mark.parametrize("attack", [*IMAGE_ATTACKS.values()], ids=lambda a: a.name)
def test_what_is_no_image_is_an_input_error(attack: Attack, image: Float32) -> None:
    for wrong in (image[..., 0], image[:0], image.astype(np.float64), (255 * image).astype(np.uint8)):
        with pytest.raises(InputError):
            attack.apply(wrong)
