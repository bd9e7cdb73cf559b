"""SIFT keypoints and their matching, shared by 2-D alignment and the search for a camera.

Descriptors are RootSIFT (Arandjelovic and Zisserman 2012) in eight bits: the square roots of the normalised
SIFT histogram, scaled to length 512. Products of such integers are exact in float32, so matching is one BLAS
product and gives the same answer on every machine.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.model import Float32, Float64, Int64
from engine.numerics.resampling import smooth
from engine.numerics.wavelet import dwt2
from engine.pictures.landmarks.config import CONFIG

LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""Weights of R, G, B in brightness (BT.601, as JPEG)."""

_LENGTH = 512.0


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints of one image: x, y (P, 2) in its pixels, and descriptors (P, 128)."""

    points: Float64
    descriptors: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)

    def turned_over(self, width: float) -> "Keypoints":
        """Those of the image turned over left to right, `width` pixels wide, to within what rounding makes of it.

        A descriptor is four rows and four columns along the keypoint's own direction, of eight directions relative to
        it, counted from that one on: what lay on its left lies on its right.
        """
        cells = self.descriptors.reshape(-1, 4, 4, 8)[:, ::-1][..., -np.arange(8) % 8]
        return Keypoints(self.points * (-1.0, 1.0) + (width, 0.0), np.ascontiguousarray(cells.reshape(-1, 128)))


def luma(image: Float32) -> Float32:
    """(H, W) brightness of an (H, W, 3) image, clipped to 0..1."""
    return np.clip(image, 0.0, 1.0) @ LUMA


def noise_level(gray: Float32) -> float:
    """Standard deviation of white noise, from the median of the finest diagonal band (Donoho 1994)."""
    if min(gray.shape) < 2:
        return 0.0
    return float(np.median(np.abs(dwt2(gray, 1)[1][0][2])) / 0.6745)


def detect_keypoints(gray: Float32, count: int, mask: npt.NDArray[Any] | None = None) -> Keypoints:
    """At most `count` SIFT keypoints of a grey image (H, W), strongest first, where `mask` allows them.

    It is stretched to its own range first, so that brightness does not decide what is found.
    """
    import cv2

    noise = noise_level(gray)
    if noise > 0.02:
        gray = smooth(gray, min(CONFIG.largest_blur, CONFIG.noise_to_blur * noise))
    low, high = float(gray.min()), float(np.quantile(gray[::4, ::4], 0.995)) if gray.size else 0.0
    stretched = np.clip((gray - low) / max(high - low, 1e-3), 0.0, 1.0)
    # Without precise upscaling every point lies a quarter of a pixel too far right and down.
    sift = cv2.SIFT_create(  # type: ignore[attr-defined]  # missing in OpenCV's stubs
        nfeatures=count, contrastThreshold=0.02, enable_precise_upscale=True
    )
    found, descriptors = sift.detectAndCompute(
        np.round(stretched * 255.0).astype(np.uint8), None if mask is None else mask.astype(np.uint8)
    )
    if descriptors is None or not len(found):
        return Keypoints(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.uint8))
    points = np.array([k.pt for k in found], dtype=np.float64) + 0.5  # OpenCV counts from pixel centres
    order = np.lexsort((points[:, 1], points[:, 0], [-k.response for k in found]))[:count]
    histogram = np.asarray(descriptors, dtype=np.float64)[order]
    root = np.sqrt(histogram / np.maximum(histogram.sum(axis=1, keepdims=True), 1e-12))
    return Keypoints(points[order], np.minimum(np.round(_LENGTH * root), 255).astype(np.uint8))


def match_within(query: npt.NDArray[np.uint8], target: npt.NDArray[np.uint8], ratio: float) -> tuple[Int64, Int64]:
    """Nearest neighbours that are clearly nearer than the second nearest (Lowe's test): indices of queries and targets,
    (M,) each.

    Of descriptors (P, 128) and (Q, 128); `ratio`, 0..1, is the largest accepted of the two distances. At most one match
    for each target: its nearest query.
    """
    empty = np.zeros(0, dtype=np.int64)
    if len(query) == 0 or len(target) < 2:
        return empty, empty
    a, b = query.astype(np.float32), target.astype(np.float32)
    distance = np.einsum("ij,ij->i", a, a)[:, None] + np.einsum("ij,ij->i", b, b)[None, :] - 2.0 * (a @ b.T)  # (P, Q)
    rows = np.arange(len(a))
    nearest = np.argmin(distance, axis=1)
    first = distance[rows, nearest].copy()
    distance[rows, nearest] = np.inf
    second = distance.min(axis=1)
    index = np.nonzero(first < ratio**2 * second)[0]
    index = index[np.argsort(first[index], kind="stable")]
    _, unique = np.unique(nearest[index], return_index=True)
    index = np.sort(index[unique])
    return index, nearest[index].astype(np.int64)
