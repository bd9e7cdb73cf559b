"""What happened to the colours of a picture and where: tone and uneven light together."""

import numpy as np

from engine.model import Bool, Float32
from engine.pictures.light_field import STILL_UNEVEN, UNEVEN, fit_light
from engine.pictures.tone_curve import Toned, fit_tone

__all__ = ["TONE_KNOTS", "fit_colors"]

TONE_KNOTS = 9
_LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
_ROUNDS = 4


def fit_colors(reference: Float32, picture: Float32, mask: Bool, knots: int = TONE_KNOTS) -> Toned:
    """Tone and uneven light by turns, each on what the other leaves; even light costs no second round.

    Parameters
    ----------
    reference, picture : (H, W, 3) float32
        0..1, in register.
    mask : (H, W) bool
        Pixels to fit on.
    knots : int
        Of a channel's tone curve.

    Returns
    -------
    Toned
        Its slope is that of the tone times the gain of the light.
    """
    toned = fit_tone(reference, picture, mask, knots)
    gain = np.ones(mask.shape, dtype=np.float32)
    for number in range(_ROUNDS):
        least = STILL_UNEVEN if number else UNEVEN
        light = fit_light(toned.predicted @ _LUMA, picture @ _LUMA, mask, least)
        if light is None:
            break
        gain = gain * light
        toned = fit_tone(reference * gain[..., None], picture, mask, knots)
    return Toned(toned.predicted, toned.slope * gain[..., None])
