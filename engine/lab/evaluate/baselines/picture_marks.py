"""Image mark, then fit: mark the renders of a model and fit its colours to them; read any render again.

The recipe of HiDDeN+3DGS in the tables of the field. One fit gives a direction in the space of colours; its length is
then set by the PSNR, so that all methods stand at the same fidelity. The picture mark is blind and reads a picture
alone: HiDDeN, which the field fits models to, has no public weights of 32 bits; a classic one stands in for its class,
keyed signs on middle frequencies of 8x8 blocks of luma (Koch and Zhao 1995; Cox et al. 1997).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import dctn, idctn
from skimage.util import view_as_blocks

from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.baselines.method import Kept, Method
from engine.lab.evaluate.baselines.model_marks import bit_scores
from engine.lab.evaluate.marked_subjects import picture_of
from engine.lab.sim.adversaries.retraining import fine_tune
from engine.model import Camera, Float32, Float64, GaussianModel, Int64
from engine.raster import render
from engine.watermark.keys import OwnerKey, permutation, signs
from engine.watermark.messages import Signs

__all__ = ["FittedPictures", "decode", "encode"]

BLOCK = 8
TILE = 8
"""Blocks a side after which the pattern repeats: 64 pixels."""
MIDDLE = tuple((u, v) for u in range(BLOCK) for v in range(BLOCK) if 2 <= u + v <= 5)
"""Carrying frequencies of a block: 18 that are neither flat nor lost to every JPEG."""
LUMA = np.array([0.299, 0.587, 0.114])
STRENGTH = 0.05
"""Of a coefficient of an orthonormal 8x8 DCT, range 1: 36 dB. The fitted model is scaled to its own PSNR afterwards."""
LIMIT = 2.0
"""Whitened coefficients saturate here: edges of the picture must not drown the rest."""


def encode(picture: Float32, key: OwnerKey, message: Signs) -> Float32:
    """A picture (H, W, 3) in 0..1 with a message; black, where a model shows nothing, stays black."""
    chips, bit = _chips(key, len(message))
    spectrum = np.zeros((TILE, TILE, BLOCK, BLOCK))
    for k, (u, v) in enumerate(MIDDLE):
        spectrum[..., u, v] = STRENGTH * chips[..., k] * message[bit[..., k]]
    blocks = idctn(spectrum, axes=(2, 3), norm="ortho")  # (TILE, TILE, 8, 8)
    tile = blocks.transpose(0, 2, 1, 3).reshape(TILE * BLOCK, TILE * BLOCK)
    height, width = picture.shape[:2]
    repeats = (-(-height // len(tile)), -(-width // len(tile)))
    pattern = np.tile(tile, repeats)[:height, :width, None]
    shows = picture.max(axis=2, keepdims=True) > 0.02
    return np.clip(picture + np.where(shows, pattern, 0.0), 0.0, 1.0).astype(np.float32)


def decode(picture: Float32, key: OwnerKey, bits: int) -> Float64:
    """(bits,) scores of a picture (H, W, 3) whose signs are the bits."""
    rows, columns = (side // BLOCK for side in picture.shape[:2])
    if not rows or not columns:
        return np.zeros(bits)
    luma = picture[: rows * BLOCK, : columns * BLOCK].astype(np.float64) @ LUMA
    spectrum = dctn(view_as_blocks(luma, (BLOCK, BLOCK)), axes=(2, 3), norm="ortho")
    found = np.stack([spectrum[..., u, v] for u, v in MIDDLE], axis=-1)  # (rows, columns, 18)
    white = found / np.maximum(np.sqrt((found**2).mean(axis=(0, 1))), 1e-9)
    white = np.clip(white, -LIMIT, LIMIT)
    chips, bit = _chips(key, bits)
    place = np.ix_(np.arange(rows) % TILE, np.arange(columns) % TILE)
    votes = (white * chips[place]).ravel()
    return bit_scores(bit[place].ravel(), votes, votes**2, bits)


def _chips(key: OwnerKey, bits: int) -> tuple[Float64, Int64]:
    """(TILE, TILE, 18) keyed signs, and the bit that each belongs to, evenly dealt."""
    subkey = key.derive("baseline dct", b"")
    shape = (TILE, TILE, len(MIDDLE))
    count = int(np.prod(shape))
    bit = permutation(subkey, count) % bits
    return signs(subkey, count).reshape(shape).astype(np.float64), bit.reshape(shape)


@dataclass(frozen=True, kw_only=True)
class FittedPictures(Method):
    """A picture mark in every training view, and a model whose colours were fitted to them."""

    views: int = 12  # training views, a regular rig about the original
    size: int = 512  # pixels a side
    epochs: int = 20  # rounds of the fit over all views
    read_views: int = 4  # of the training views, how many a model is read at; their scores are summed

    def cameras(self, original: GaussianModel) -> list[Camera]:
        """The training views: where a picture is read best."""
        return make_rig(original, self.views, self.size, self.size)

    def colors(self, model: GaussianModel, key: OwnerKey, message: Signs) -> tuple[Callable[[float], Float32], float]:
        """See `Method`; the strength is a factor on the fitted change of colours."""
        training = self.cameras(model)
        pictures = [encode(np.clip(render(model, camera), 0.0, 1.0), key, message) for camera in training]
        change = fine_tune(model, training, pictures, self.epochs, trained="colors").sh - model.sh

        return (lambda factor: np.asarray(model.sh + np.float32(factor) * change)), 1.0

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64:
        """See `Method`: 8-bit renders of the suspect at the owner's training views, wherever it was moved to."""
        cameras = self.cameras(kept.original)[:: max(1, self.views // self.read_views)]
        return np.asarray(np.sum([self.read_picture(picture_of(suspect, c), kept) for c in cameras], axis=0))

    def read_picture(self, picture: Float32, kept: Kept) -> Float64:
        """See `Method`."""
        return decode(picture, kept.key, kept.bits)
