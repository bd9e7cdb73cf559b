"""The attacks of Table 2 in all their readings, on pictures and on the model."""

from pathlib import Path
from typing import Any

import numpy as np

from engine.evaluate.study import Row
from engine.evaluate.tables.cells.settings import mark
from engine.evaluate.tables.cells.shots import cameras_for, read_bits, readings_of_picture
from engine.evaluate.tables.setting import DEFAULT
from engine.pipeline.verification import VerifyConfig, verify_model
from engine.raster import render
from engine.sim.attacks import model_attack

__all__ = ["ON_MODELS", "ON_PICTURES", "attack_models", "attack_pictures"]

ON_PICTURES: dict[str, dict[str, tuple[str, float, str]]] = {
    "literal": {
        "none": ("", 0.0, "literal"),
        "rotation": ("rotate_image", 30.0, "literal"),
        "scaling": ("scale_image", 0.75, "literal"),
        "crop": ("crop_image", 0.4, "literal"),
        "jpeg": ("jpeg", 10, "literal"),
        "noise": ("noise_image", 0.1, "literal"),
    },
    "as_code": {
        "rotation": ("rotate_image", 30.0, "as_code"),
        "scaling": ("scale_image", 0.75, "as_code"),
        "crop": ("crop_image", 0.4, "as_code"),
        "noise": ("noise_image", 0.01, "as_code"),
    },
}
"""Reading -> column -> attack, strength, reading. JPEG means quality 10 in both."""

ON_MODELS: dict[str, dict[str, tuple[str, float, str]]] = {
    "literal": {
        "none": ("", 0.0, "literal"),
        "rotation": ("rotate", 30.0, "literal"),
        "scaling": ("scale", 0.75, "literal"),
        "crop": ("crop", 0.6, "literal"),
        "noise": ("noise_all", 0.1, "literal"),
        "clone": ("clone", 0.5, "literal"),
        "prune": ("prune_random", 0.2, "literal"),
        "10 % left, random": ("prune_random", 0.9, "literal"),
        "10 % left, one piece": ("crop", 0.1, "literal"),
    },
    "as_code": {"crop": ("crop", 0.4, "as_code"), "clone": ("clone", 0.5, "as_code")},
}
"""The same words said of a model. As code: crop drops a block of the file, cloning copies Gaussians as they are."""


def attack_pictures(
    scene: str, seed: int, views: int, size: int, changes: dict[str, Any], columns: list[str]
) -> list[Row]:
    """Attacks on one picture at a time, camera known; a row for each view, reading and column."""
    marked = mark(scene, DEFAULT, seed, changes)
    rows = []
    for k, camera in enumerate(cameras_for(marked.original, views, size, seed)):
        picture = render(marked.marked, camera)
        for number, (label, attacks) in enumerate(ON_PICTURES.items()):
            wanted = {column: attack for column, attack in attacks.items() if column in columns}
            for reading in readings_of_picture(picture, camera, marked, wanted, (seed, k, number)):
                rows.append(
                    {"scene": Path(scene).name, "seed": seed, "on": "picture", "reading": label, "view": k, **reading}
                )
    return rows


def attack_models(scene: str, seed: int, changes: dict[str, Any], columns: list[str]) -> list[Row]:
    """Attacks on the marked model; a row for each reading and column."""
    marked = mark(scene, DEFAULT, seed, changes)
    rows = []
    for kind, (label, attacks) in enumerate(ON_MODELS.items()):
        for number, (column, (attack, strength, reading)) in enumerate(attacks.items()):
            if column not in columns:
                continue
            suspect = marked.marked
            if attack:
                rng = np.random.default_rng((seed, kind, number))
                suspect = model_attack(attack).apply(suspect, strength, rng=rng, reading=reading)
            result = verify_model(suspect, marked.opened, VerifyConfig(route="model"))
            rows.append(
                {
                    "scene": Path(scene).name,
                    "seed": seed,
                    "on": "model",
                    "reading": label,
                    "attack": column,
                    **read_bits(result, marked, "model"),
                }
            )
    return rows
