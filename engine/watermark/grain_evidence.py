"""What a registered suspect says about every chip of the grain (DESIGN 4.8): made without looking at any chip.

Each matched Gaussian is compared with its reference in the reference's own axes. How much a difference tells is learnt
from the differences themselves, by their size alone: for Gaussians of like size, since what a format rounds is small
against a large one and large against a small one.
"""

# mypy: allow-untyped-defs

import math

import numpy as np

from engine.model import Bool, Float32, Float64, GaussianModel, Int32
from engine.numerics.jit import inlined, parallel_kernel, share_of
from engine.numerics.similarity import rotation_to_quaternion
from engine.numerics.umeyama import Similarity
from engine.watermark.grain import ATTRIBUTES, FLAT, Grain, thin
from engine.watermark.model_evidence import Evidence

_KERNEL_VERSION = 1

SURE = 0.8
"""Cosine between an axis and its partner's from which the axes tell which scale is which; below, their order does."""
SIZES = 16
"""Classes of like size; each spans a factor of two, the middle one begins at the median."""
OCTAVES, PER_OCTAVE = 48, 8
"""Range and resolution of the histogram in which the usual size of a difference is looked up."""
LOST = 4.0
"""Deviations beyond which a difference is no displacement but a wrong match, and says nothing."""


@inlined
def _product(a, b):
    """Hamilton product of two quaternions."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@inlined
def _axes(q):
    """The three axes that a unit quaternion turns those of space into."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@inlined
def _ranks(s):
    """Rank of each of three numbers, equal ones in their order."""
    above = (s[1] < s[0], s[2] < s[0], s[2] < s[1])
    return above[0] + above[1], 1 - above[0] + above[2], 2 - above[1] - above[2]


@inlined
def _like(axis, others):
    """Which of three axes lies most along this one, and the cosine."""
    best, most = 0, -1.0
    for b in range(3):
        cosine = abs(axis[0] * others[b][0] + axis[1] * others[b][1] + axis[2] * others[b][2])
        if cosine > most:
            best, most = b, cosine
    return best, most


@inlined
def _partners(ref_axes, axes, ref_logs, logs):
    """Which axis of the suspect each of the reference is: the one along it, or where two turn into each other (all
    but equal scales), the one of equal rank."""
    first, c0 = _like(ref_axes[0], axes)
    second, c1 = _like(ref_axes[1], axes)
    third, c2 = _like(ref_axes[2], axes)
    if first + second + third == 3 and first != second and min(c0, min(c1, c2)) > SURE:
        return first, second, third
    r, s = _ranks(ref_logs), _ranks(logs)
    place = (
        0 if s[0] == r[0] else (1 if s[1] == r[0] else 2),
        0 if s[0] == r[1] else (1 if s[1] == r[1] else 2),
        0 if s[0] == r[2] else (1 if s[1] == r[2] else 2),
    )
    return place


@parallel_kernel
def _differences(means, log_scales, quats, ref_means, ref_log_scales, ref_quats, target, move, shift, turn, out, call):
    """Fills out (n, 6): centre in `units` along the reference's axes, and log scales, suspect less reference.

    `target` (n,) reference row of each suspect row or -1; `move` (3, 3) scale times rotation and `shift` (3,) take the
    suspect to the reference, `turn` (5,) is the rotation's quaternion and the logarithm of the scale.
    """
    whole = (turn[0], turn[1], turn[2], turn[3])
    for i in share_of(len(target), call):
        j = target[i]
        if j < 0:
            continue
        q = quats[i]
        axes = _axes(_product(whole, (np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3]))))
        q = ref_quats[j]
        ref_axes = _axes((np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3])))
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        gap = (
            move[0, 0] * x + move[0, 1] * y + move[0, 2] * z + shift[0] - ref_means[j, 0],
            move[1, 0] * x + move[1, 1] * y + move[1, 2] * z + shift[1] - ref_means[j, 1],
            move[2, 0] * x + move[2, 1] * y + move[2, 2] * z + shift[2] - ref_means[j, 2],
        )
        ref_logs = (
            np.float64(ref_log_scales[j, 0]),
            np.float64(ref_log_scales[j, 1]),
            np.float64(ref_log_scales[j, 2]),
        )
        logs = (np.float64(log_scales[i, 0]), np.float64(log_scales[i, 1]), np.float64(log_scales[i, 2]))
        top, bottom = max(ref_logs[0], max(ref_logs[1], ref_logs[2])), min(ref_logs[0], min(ref_logs[1], ref_logs[2]))
        least = FLAT * math.exp(ref_logs[0] + ref_logs[1] + ref_logs[2] - top - bottom)
        partner = _partners(ref_axes, axes, ref_logs, logs)
        for a in range(3):
            along = ref_axes[a][0] * gap[0] + ref_axes[a][1] * gap[1] + ref_axes[a][2] * gap[2]
            out[i, a] = along / max(math.exp(ref_logs[a]), least)
            out[i, 3 + a] = logs[partner[a]] + turn[4] - ref_logs[a]


def gather_grain_evidence(
    grain: Grain, reference: GaussianModel, suspect: GaussianModel, fit: Similarity, matches: Int32, quality: Float32
) -> Evidence:
    """Displacement of every centre and log scale, against how much Gaussians of like size are off.

    Parameters
    ----------
    fit : Similarity
        From the suspect to the reference.
    matches : (n,) int32
        Reference row of each suspect Gaussian, or -1.
    quality : (n,) float32
        Trust in each match, 0 to 1.

    Returns
    -------
    Evidence
        Of 6 N chips, N Gaussians of the reference.
    """
    found = np.where(quality > 0, matches, -1).astype(np.int32)
    out = np.zeros((len(suspect), ATTRIBUTES), dtype=np.float32)
    turn = np.append(rotation_to_quaternion(fit.R), math.log(fit.scale))
    _differences(
        suspect.means,
        suspect.log_scales,
        suspect.quats,
        reference.means,
        reference.log_scales,
        reference.quats,
        found,
        np.ascontiguousarray(fit.scale * fit.R, dtype=np.float64),
        np.asarray(fit.t, dtype=np.float64),
        turn,
        out,
    )
    y, trust = _by_reference(out, found, quality, len(reference))
    amplitudes = np.repeat(np.array([grain.center, grain.scale]), 3)  # (6,)
    carries = np.ones_like(y, dtype=bool)
    carries[:, 3:] = ~thin(reference.log_scales)
    noise = _usual(y, trust > 0, _size_classes(reference.log_scales))  # (N, 6)
    far = np.square(y / (LOST * np.maximum(noise, amplitudes)))
    sure = trust[:, None] * np.square(np.maximum(1.0 - far, 0.0))  # Tukey's: an even function of y, blind to its sign
    weights = np.where(carries, sure * amplitudes / (np.square(noise) + np.square(amplitudes)), 0.0)
    signal = np.where((trust[:, None] > 0) & carries, amplitudes, 0.0)
    return Evidence(y.reshape(-1), weights.reshape(-1), signal.reshape(-1))


def _by_reference(rows: Float32, found: Int32, quality: Float32, count: int) -> tuple[Float64, Float64]:
    """(N, 6) mean difference of each reference Gaussian, over all that are its copies, and (N,) trust."""
    hit = np.flatnonzero(found >= 0)
    target, trust = found[hit], quality[hit].astype(np.float64)
    times = np.bincount(target, minlength=count)
    y = np.zeros((count, ATTRIBUTES))
    if times.max(initial=0) <= 1:
        total = np.zeros(count)
        y[target], total[target] = rows[hit], trust
        return y, total
    total = np.bincount(target, trust, count).astype(np.float64)
    for a in range(ATTRIBUTES):
        y[:, a] = np.bincount(target, trust * rows[hit, a], count) / np.maximum(total, 1e-12)
    return y, np.minimum(total, 1.0)


def _size_classes(log_scales: Float32) -> Int32:
    """(N, 3) class 0 to SIZES - 1 of each axis, a factor of two in length each."""
    octaves = log_scales * np.float32(1.0 / math.log(2.0))
    steps = np.floor(octaves - np.median(octaves[:: max(1, len(octaves) // 10_000)]))
    return np.asarray(np.clip(steps.astype(np.int32) + SIZES // 2, 0, SIZES - 1))


def _usual(y: Float64, seen: Bool, classes: Int32) -> Float64:
    """(N, 6) robust deviation of differences of the same kind and class: the median size over 0.6745.

    From a histogram over the logarithm of the size, PER_OCTAVE to a factor of two; centres and scales are two kinds.
    """
    with np.errstate(divide="ignore"):
        size = np.log2(np.abs(y))
    bins = np.clip((size + OCTAVES / 2) * PER_OCTAVE, 0, OCTAVES * PER_OCTAVE - 1).astype(np.int32)  # (N, 6)
    kinds = np.concatenate([classes, classes + SIZES], axis=1)
    width = OCTAVES * PER_OCTAVE
    table = np.bincount((kinds * width + bins)[seen].reshape(-1), minlength=2 * SIZES * width)
    running = np.cumsum(table.reshape(2 * SIZES, width), axis=1)
    middle = np.argmax(2 * running >= running[:, -1:], axis=1)  # bin of the median
    deviation = 2.0 ** ((middle + 0.5) / PER_OCTAVE - OCTAVES / 2) / 0.6745
    return np.asarray(deviation[kinds])
