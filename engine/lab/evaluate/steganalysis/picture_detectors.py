"""Steganalysis of 8-bit pictures: how much of a picture's least significant bits were replaced?

StegExpose (Boehm 2014), which the paper's Figure 5 uses, averages four detectors; these are the same four, written from
the works they come from. Each takes a channel, (H, W) uint8 of at least 4 x 4, and estimates the embedding rate: the
share of the pixels that carry a message bit, near 0 for a cover, near 1 where every pixel carries a bit; all but
chi-square may leave that range a little.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from engine.errors import InputError
from engine.flows.embed.profiles import profile
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import mark_scene
from engine.lab.evaluate.study import Row
from engine.model import Float32
from engine.raster import render

__all__ = [
    "DETECTORS",
    "chi_square",
    "fuse",
    "look_at_renders",
    "primary_sets",
    "replace_lsb",
    "rs_analysis",
    "sample_pairs",
]

Picture = npt.NDArray[np.uint8]
Channel = npt.NDArray[np.int32]

CHUNK = 1024
"""Pixels after which the chi-square attack looks again, as StegExpose does."""
LEAST_EXPECTED = 5.0
"""Pairs of values seen less often say nothing about chi-square."""
LARGEST_TRACE = 30
"""Of sample pairs: differences up to 2 * 30 + 1, as in the work."""
MASK = np.array([False, True, True, False])
"""Of RS analysis, on groups of four pixels in a row."""
CHECKED_RATES = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Embedding rates at which the detectors are checked."""


def chi_square(channel: Picture) -> float:
    """Mean probability that pairs of values (2k, 2k + 1) are equally frequent, from the top to ever further down.

    About the share of the picture that is filled when the message was written from the top (Westfeld, Pfitzmann,
    "Attacks on steganographic systems", Information Hiding 1999).
    """
    flat = _channel(channel).reshape(-1)
    chunks = np.arange(len(flat)) // CHUNK
    counts = np.bincount(chunks * 256 + flat, minlength=(int(chunks[-1]) + 1) * 256)
    seen = np.cumsum(counts.reshape(-1, 256), axis=0).reshape(-1, 128, 2).astype(np.float64)
    expected = seen.mean(axis=2)
    usable = expected >= LEAST_EXPECTED
    statistic = np.where(usable, (seen[..., 0] - expected) ** 2 / np.maximum(expected, 1.0), 0.0).sum(axis=1)
    freedom = usable.sum(axis=1) - 1
    probability = np.where(freedom > 0, chi2.sf(statistic, np.maximum(freedom, 1)), 0.0)
    return float(probability.mean())


def primary_sets(channel: Picture) -> float:
    """Embedding rate by the sets X, Y, Z, W of neighbouring pixels.

    Dumitrescu, Wu, Memon, "On steganalysis of random LSB embedding in continuous-tone images", ICIP 2002.
    """
    u, v = _pairs(_channel(channel))
    even = v % 2 == 0
    x = int(np.where(even, u < v, u > v).sum())
    z = int((u == v).sum())
    y = len(u) - x - z
    w = int(((u >> 1 == v >> 1) & (u != v)).sum())
    return _smaller_root(0.5 * (w + z), 2.0 * x - len(u), float(y - x))


def sample_pairs(channel: Picture) -> float:
    """Embedding rate by the trace sets of neighbouring pixels, differences up to 61; of all, it is `primary_sets`.

    Dumitrescu, Wu, Wang, "Detection of LSB steganography via sample pair analysis", IEEE TSP 51(7), 2003; equation 14.
    """
    u, v = _pairs(_channel(channel))
    gap = np.abs(u - v)
    halves = np.abs((u >> 1) - (v >> 1))
    odd = (gap % 2 == 1) & (gap <= 2 * LARGEST_TRACE + 1)
    x = int((odd & (halves == (gap + 1) // 2)).sum())  # D_{2m+1} in C_{m+1}
    y = int((odd & (halves == gap // 2)).sum())  # D_{2m+1} in C_m
    c = [int((halves == m).sum()) for m in (0, LARGEST_TRACE + 1)]
    d = [int((gap == n).sum()) for n in (0, 2 * LARGEST_TRACE + 2)]
    return _smaller_root((2.0 * c[0] - c[1]) / 4.0, -(2.0 * d[0] - d[1] + 2.0 * (y - x)) / 2.0, float(y - x))


def rs_analysis(channel: Picture) -> float:
    """Embedding rate by regular and singular groups of four pixels.

    Fridrich, Goljan, Du, "Reliable detection of LSB steganography in color and grayscale images", ACM 2001.
    """
    image = _channel(channel)
    groups = image[:, : image.shape[1] // 4 * 4].reshape(-1, 4)  # (n, 4)
    (d0, shifted_d0), (d1, shifted_d1) = _regular_minus_singular(groups), _regular_minus_singular(groups ^ 1)
    # The work solves a x^2 + b x + c = 0 and takes p = x / (x - 1/2), which is infinite at p = 1, where a and b vanish.
    # Put x = p / (2 (p - 1)) and solve for p itself: a double root at 1 there.
    a, b, c = 2.0 * (d1 + d0), shifted_d0 - shifted_d1 - d1 - 3.0 * d0, d0 - shifted_d0
    return _smaller_root(0.25 * a + 0.5 * b + c, -0.5 * b - 2.0 * c, c)


DETECTORS = {"primary sets": primary_sets, "chi-square": chi_square, "sample pairs": sample_pairs, "RS": rs_analysis}
"""By name; each takes one 8-bit channel."""


def fuse(picture: Picture) -> dict[str, float]:
    """Each detector's mean over a picture's (H, W, 3) channels, and StegExpose's standard ``fusion``.

    The fusion is the mean of the four, each clipped to 0..1.
    """
    if picture.ndim != 3:
        raise InputError(f"expected a picture (H, W, C), got shape {picture.shape}")
    channels = [np.ascontiguousarray(picture[..., c]) for c in range(picture.shape[2])]
    found = {name: float(np.mean([detect(channel) for channel in channels])) for name, detect in DETECTORS.items()}
    return {**found, "fusion": float(np.mean(np.clip(list(found.values()), 0.0, 1.0)))}


def replace_lsb(picture: Picture, rate: float, rng: np.random.Generator) -> Picture:
    """A picture whose least significant bits carry random bits in that share of all places, chosen at random."""
    carries = rng.random(picture.shape) < rate
    bits = rng.integers(0, 2, picture.shape, dtype=np.uint8)
    return np.where(carries, (picture & 0xFE) | bits, picture).astype(np.uint8)


def _channel(channel: Picture) -> Channel:
    if channel.ndim != 2 or channel.dtype != np.uint8 or min(channel.shape) < 4:
        raise InputError(f"expected a channel (H, W) of uint8, at least 4x4, got {channel.shape} of {channel.dtype}")
    return channel.astype(np.int32)


def _pairs(image: Channel) -> tuple[Channel, Channel]:
    """All neighbours in rows and columns, as two flat arrays."""
    u = np.concatenate([image[:, :-1].ravel(), image[:-1].ravel()])
    return u, np.concatenate([image[:, 1:].ravel(), image[1:].ravel()])


def _regular_minus_singular(groups: Channel) -> tuple[float, float]:
    """Share of regular minus singular groups (n, 4) under the mask, and under the shifted flip (the mask times -1)."""
    upward = np.where(MASK, groups ^ 1, groups)  # 0 <-> 1, 2 <-> 3, ...
    downward = np.where(MASK, ((groups + 1) ^ 1) - 1, groups)  # -1 <-> 0, 1 <-> 2, ...
    plain, up, down = (np.abs(np.diff(pixels, axis=1)).sum(axis=1) for pixels in (groups, upward, downward))
    return float(np.sign(up - plain).mean()), float(np.sign(down - plain).mean())


def _smaller_root(a: float, b: float, c: float) -> float:
    """Of a x^2 + b x + c the root nearest to 0; where there is none, the place of the extremum."""
    if abs(a) < 1e-12:
        return -c / b if abs(b) > 1e-12 else 0.0
    inside = b * b - 4.0 * a * c
    if inside < 0.0:
        return -b / (2.0 * a)
    return float(min(((-b + sign * np.sqrt(inside)) / (2.0 * a) for sign in (1.0, -1.0)), key=abs))


def look_at_renders(path: str, profile_name: str, views: int, checked_views: int, size: int, seed: int) -> list[Row]:
    """Every detector on 8-bit renders of one scene, `size` pixels a side: the same views unmarked and marked.

    Of the first `checked_views` the unmarked ones also get replaced bits, to check the detectors. One row a picture:
    ``kind`` "unmarked", "marked" or "lsb", its ``rate``, and each detector's estimate.
    """
    scene = mark_scene(path, profile(profile_name, landmark_views=0), seed=seed)
    rng = np.random.default_rng((seed, 9))
    rows: list[Row] = []
    for number, camera in enumerate(make_rig(scene.original, views, size, size, jitter=rng.random((views, 4)))):
        about = {"scene": Path(path).name, "seed": seed, "view": number}
        plain, marked = (_stored(render(model, camera)) for model in (scene.original, scene.marked))
        rows.append({**about, "kind": "unmarked", "rate": 0.0, **fuse(plain)})
        rows.append({**about, "kind": "marked", "rate": 0.0, **fuse(marked)})
        for rate in CHECKED_RATES if number < checked_views else ():
            rows.append({**about, "kind": "lsb", "rate": rate, **fuse(replace_lsb(plain, rate, rng))})
    return rows


def _stored(image: Float32) -> Picture:
    return np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
