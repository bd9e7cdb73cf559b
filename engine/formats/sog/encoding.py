"""From the attributes of Gaussians to the parts of a SOG scene, version 2."""

import json
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.formats.modes import ANTIALIASED, mode_of
from engine.formats.morton import morton_order
from engine.formats.smallest_three import take_apart
from engine.formats.sog.archive import META
from engine.formats.sog.codebook import learn_codebook, nearest_codes
from engine.formats.sog.decoding import QUATERNION_TAG
from engine.formats.sog.images import MAX_SIDE, Pixels, encode_webp
from engine.formats.sog.meta import PALETTE_ROW
from engine.formats.sog.palette import learn_palette, palette_size
from engine.kernels.jit import side_by_side
from engine.model import Float32, Float64, GaussianModel
from engine.numerics.plain import Json

FILES = {
    "means": ("means_l.webp", "means_u.webp"),
    "scales": ("scales.webp",),
    "quats": ("quats.webp",),
    "sh0": ("sh0.webp",),
    "shN": ("shN_centroids.webp", "shN_labels.webp"),
}


def encode_scene(model: GaussianModel) -> dict[str, bytes]:
    """Names and bytes of all parts; see `engine.formats.sog.bundle.write_sog`."""
    width, height = image_size(len(model))
    codes, mins, maxs = position_codes(model.means)
    order = morton_order(codes.astype(np.float32))
    codes, model = codes[order], model.take(order)
    scales = learn_codebook(model.log_scales)
    dc = learn_codebook(model.sh[:, 0])
    alpha = np.rint(model.opacities * np.float32(255.0)).astype(np.uint8)
    images = {
        FILES["means"][0]: (codes & 0xFF).astype(np.uint8),
        FILES["means"][1]: (codes >> 8).astype(np.uint8),
        FILES["scales"][0]: nearest_codes(model.log_scales, scales),
        FILES["quats"][0]: quaternion_pixels(model.quats),
        FILES["sh0"][0]: np.concatenate([nearest_codes(model.sh[:, 0], dc), alpha[:, None]], axis=1),
    }
    meta: Json = {
        "version": 2,
        "asset": {"generator": "Mark3DGS"},
        "count": len(model),
        "means": {"mins": mins.tolist(), "maxs": maxs.tolist(), "files": FILES["means"]},
        "scales": {"codebook": scales.tolist(), "files": FILES["scales"]},
        "quats": {"files": FILES["quats"]},
        "sh0": {"codebook": dc.tolist(), "files": FILES["sh0"]},
    }
    if mode := mode_of(model):
        meta |= {"model": mode, "antialias": mode == ANTIALIASED}
    laid_out: dict[str, Pixels] = {}
    if model.sh_degree > 0:
        vectors = model.sh[:, 1:].reshape(len(model), -1)  # (N, 3 (K - 1))
        book, labels = learn_palette(vectors, palette_size(len(model)))
        centroids, codebook = centroid_pixels(book, labels)
        images[FILES["shN"][1]] = label_pixels(labels)
        laid_out[FILES["shN"][0]] = centroids
        named = {"codebook": codebook.tolist(), "files": FILES["shN"]}
        meta["shN"] = {"count": len(book), "bands": model.sh_degree, **named}
    laid_out |= {name: _lay_out(pixels, width, height) for name, pixels in images.items()}
    parts = dict(zip(laid_out, side_by_side(encode_webp, laid_out.values()), strict=True))
    text = json.dumps(meta, separators=(",", ":"), allow_nan=False).encode()
    return {META: text, **dict(sorted(parts.items()))}


def image_size(count: int) -> tuple[int, int]:
    """Width and height for so many pixels, as PlayCanvas's writer: nearly square, multiples of four."""
    if count < 1:
        raise InputError("a SOG scene needs at least one Gaussian")
    width = int(np.ceil(np.sqrt(count) / 4.0)) * 4
    height = -(-count // (width * 4)) * 4
    if width > MAX_SIDE:
        raise InputError(f"{count} Gaussians do not fit into images of {MAX_SIDE} pixels a side")
    return width, height


def position_codes(means: Float32) -> tuple[npt.NDArray[np.uint16], Float64, Float64]:
    """(N, 3) 16-bit codes of sign(x) log(1 + abs(x)) and its range (3,), (3,): fine steps near the origin."""
    x = means.astype(np.float64)
    bent = np.sign(x) * np.log1p(np.abs(x))
    mins, maxs = bent.min(axis=0), bent.max(axis=0)
    span = np.where(maxs > mins, maxs - mins, 1.0)
    return np.rint((bent - mins) / span * 65535.0).astype(np.uint16), mins, maxs


def quaternion_pixels(quats: Float32) -> Pixels:
    """(N, 4) the three smallest components in steps of sqrt(2) / 255, and the tag of the largest."""
    q = quats.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    small, largest = take_apart(q)
    pixels = np.empty((len(q), 4), dtype=np.uint8)
    pixels[:, :3] = np.rint(255.0 * np.clip(small * np.sqrt(0.5) + 0.5, 0.0, 1.0))
    pixels[:, 3] = QUATERNION_TAG + largest
    return pixels


def centroid_pixels(book: Float32, labels: npt.NDArray[Any]) -> tuple[Pixels, Float32]:
    """Image of the code vectors (P, d), 64 in a row, and its codebook, which weighs each by its use."""
    used = np.bincount(labels, minlength=len(book)).astype(np.float64)
    codebook = learn_codebook(book, np.broadcast_to(used[:, None], book.shape))
    count, rest = len(book), book.shape[1] // 3
    pixels = np.zeros((-(-count // PALETTE_ROW) * PALETTE_ROW, rest, 3), dtype=np.uint8)
    pixels[:count] = nearest_codes(book, codebook).reshape(count, rest, 3)
    return pixels.reshape(-1, PALETTE_ROW * rest, 3), codebook  # (rows, 64 (K - 1), 3)


def label_pixels(labels: npt.NDArray[Any]) -> Pixels:
    """(N, 3) low byte, high byte, zero."""
    return np.column_stack([labels & 0xFF, labels >> 8, np.zeros_like(labels)]).astype(np.uint8)


def _lay_out(pixels: Pixels, width: int, height: int) -> Pixels:
    canvas = np.zeros((height * width, pixels.shape[1]), dtype=np.uint8)
    canvas[: len(pixels)] = pixels
    return canvas.reshape(height, width, -1)
