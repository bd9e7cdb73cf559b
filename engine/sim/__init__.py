"""MarkGS-Sim: what happens to stolen models and screenshots, as functions with named strengths."""

from engine.sim.attack import Attack, Reading, Strength
from engine.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS, find_attack, image_attack, model_attack

__all__ = [
    "IMAGE_ATTACKS",
    "MODEL_ATTACKS",
    "Attack",
    "Reading",
    "Strength",
    "find_attack",
    "image_attack",
    "model_attack",
]
