"""What a registered suspect says about every chip of the grain (DESIGN 4.8): made without looking at any chip.

Each matched Gaussian is compared with its reference in the reference's own axes. How much a difference tells is learnt
from the differences themselves, by their size alone: for Gaussians of like size, since what a format rounds is small
against a large one and large against a small one.
"""

# mypy: allow-untyped-defs

import math

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.similarity import rotation_to_quaternion
from engine.numerics.umeyama import Similarity
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES, Grain, axes_of, middle_of, turned_axes
from engine.watermark.model_evidence import Evidence

FLAT, THINNEST = CONFIG.grain.flat, CONFIG.grain.thinnest
SURE, LOST = CONFIG.grain.sure, CONFIG.grain.lost
SIZES = 16
"""Classes of like size; each spans a factor of two, the middle one begins at the median."""
OCTAVES, PER_OCTAVE = 48, 8
"""Range and resolution of the histogram in which the usual size of a difference is looked up."""
_WIDTH = OCTAVES * PER_OCTAVE


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
    return (
        0 if s[0] == r[0] else (1 if s[1] == r[0] else 2),
        0 if s[0] == r[1] else (1 if s[1] == r[1] else 2),
        0 if s[0] == r[2] else (1 if s[1] == r[2] else 2),
    )


@inlined
def _row(values, i):
    """Three numbers in double precision."""
    return np.float64(values[i, 0]), np.float64(values[i, 1]), np.float64(values[i, 2])


@parallel_kernel
def _differences(
    means, log_scales, quats, ref_means, ref_log_scales, ref_quats, target, rows, move, shift, turn, out, call
):
    """Fills out (R, 6): centre in `units` along the reference's axes, and log scales, suspect less reference.

    `target` (n,) reference row of each suspect row or -1, `rows` (n,) that of `out` where it goes; `move` (3, 3) scale
    times rotation and `shift` (3,) take the suspect to the reference, `turn` (5,) is the rotation's quaternion and the
    logarithm of the scale.
    """
    whole = (turn[0], turn[1], turn[2], turn[3])
    for i in share_of(len(target), call):
        j = target[i]
        if j < 0:
            continue
        q = quats[i]
        axes = axes_of(_product(whole, (np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3]))))
        ref_axes = turned_axes(ref_quats, j)
        x, y, z = _row(means, i)
        gap = (
            move[0, 0] * x + move[0, 1] * y + move[0, 2] * z + shift[0] - ref_means[j, 0],
            move[1, 0] * x + move[1, 1] * y + move[1, 2] * z + shift[1] - ref_means[j, 1],
            move[2, 0] * x + move[2, 1] * y + move[2, 2] * z + shift[2] - ref_means[j, 2],
        )
        ref_logs, logs = _row(ref_log_scales, j), _row(log_scales, i)
        top, bottom = max(ref_logs[0], max(ref_logs[1], ref_logs[2])), min(ref_logs[0], min(ref_logs[1], ref_logs[2]))
        least = FLAT * math.exp(ref_logs[0] + ref_logs[1] + ref_logs[2] - top - bottom)
        partner = _partners(ref_axes, axes, ref_logs, logs)
        for a in range(3):
            along = ref_axes[a][0] * gap[0] + ref_axes[a][1] * gap[1] + ref_axes[a][2] * gap[2]
            out[rows[i], a] = along / max(math.exp(ref_logs[a]), least)
            out[rows[i], 3 + a] = logs[partner[a]] + turn[4] - ref_logs[a]


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
    hit = np.flatnonzero(found >= 0)
    alone = np.bincount(found[hit], minlength=len(reference)).max(initial=0) <= 1
    y = np.zeros((len(reference) if alone else len(suspect), ATTRIBUTES))
    _differences(
        suspect.means,
        suspect.log_scales,
        suspect.quats,
        reference.means,
        reference.log_scales,
        reference.quats,
        found,
        found if alone else np.arange(len(suspect), dtype=np.int32),
        np.ascontiguousarray(fit.scale * fit.R, dtype=np.float64),
        np.asarray(fit.t, dtype=np.float64),
        np.append(rotation_to_quaternion(fit.R), math.log(fit.scale)),
        y,
    )
    trust = np.bincount(found[hit], quality[hit], len(reference)).astype(np.float64)
    if not alone:
        y, trust = _by_reference(y[hit], found[hit], quality[hit], trust)
    scales = reference.log_scales
    origin = float(np.median(scales[:: max(1, len(scales) // 10_000)])) / math.log(2.0) - SIZES // 2
    usual = _usual(y, trust, scales, origin)
    weights, linear, signal = np.empty_like(y), np.empty_like(y), np.empty_like(y)
    _weigh(y, trust, scales, origin, usual, np.array([grain.center, grain.scale]), weights, linear, signal)
    return Evidence(y.reshape(-1), weights.reshape(-1), signal.reshape(-1), linear.reshape(-1))


def _by_reference(y: Float64, found: Int32, quality: Float32, total: Float64) -> tuple[Float64, Float64]:
    """(N, 6) mean difference of each reference Gaussian over all that are its copies, and (N,) trust, of rows (h, 6),
    what they are found to be, the trust in each, and its sum for each reference Gaussian."""
    mean = np.stack([np.bincount(found, quality * column, len(total)) for column in y.T], axis=1)
    return mean / np.maximum(total, 1e-12)[:, None], np.minimum(total, 1.0)


@inlined
def _size_class(log_scale, origin):
    """Class 0 to SIZES - 1 of an axis, a factor of two in length each."""
    return min(max(math.floor(log_scale * (1.0 / math.log(2.0)) - origin), 0), SIZES - 1)


@parallel_kernel
def _count_sizes(y, trust, log_scales, origin, table, call):
    """How often differences of each kind, class and size occur, to table (calls, 2, SIZES, _WIDTH), which holds zeros;
    centres and scales are two kinds."""
    mine = table[call[0]]
    for i in share_of(len(y), call):
        if trust[i] > 0.0:
            for a in range(ATTRIBUTES):
                size = abs(y[i, a])
                octave = math.log2(size) + OCTAVES / 2 if size > 0.0 else 0.0
                place = int(min(max(octave * PER_OCTAVE, 0.0), _WIDTH - 1.0))
                mine[a // 3, _size_class(log_scales[i, a % 3], origin), place] += 1


@parallel_kernel
def _weigh(y, trust, log_scales, origin, usual, amplitudes, weights, linear, signal, call):
    """What each difference tells, to weights, those that do not fall with its size, and signal (N, 6)."""
    for i in share_of(len(y), call):
        scales = (math.exp(log_scales[i, 0]), math.exp(log_scales[i, 1]), math.exp(log_scales[i, 2]))
        least = THINNEST * middle_of(scales)
        for a in range(ATTRIBUTES):
            kind, axis = a // 3, a % 3
            amplitude, noise = amplitudes[kind], usual[kind, _size_class(log_scales[i, axis], origin)]
            carries = kind == 0 or scales[axis] >= least
            far = y[i, a] / (LOST * max(noise, amplitude))
            sure = max(1.0 - far * far, 0.0)  # Tukey's: an even function of y, blind to its sign
            weight = trust[i] * amplitude / (noise * noise + amplitude * amplitude) if amplitude > 0.0 else 0.0
            linear[i, a] = weight if carries else 0.0
            weights[i, a] = linear[i, a] * sure * sure
            signal[i, a] = amplitude if carries and trust[i] > 0.0 else 0.0


def _usual(y: Float64, trust: Float64, log_scales: Float32, origin: float) -> Float64:
    """(2, SIZES) robust deviation of differences of one kind and class: the median size over 0.6745.

    From a histogram over the logarithm of the size, PER_OCTAVE to a factor of two.
    """
    tables = np.zeros((thread_count(), 2, SIZES, _WIDTH), np.int64)
    _count_sizes(y, trust, log_scales, origin, tables)
    running = np.cumsum(tables.sum(axis=0), axis=2)
    middle = np.argmax(2 * running >= running[:, :, -1:], axis=2)  # bin of the median
    return np.asarray(2.0 ** ((middle + 0.5) / PER_OCTAVE - OCTAVES / 2) / 0.6745)
