"""Views of a model that a picture's keypoints vote for, where too few stand out to make a camera (DESIGN 4.8).

Each keypoint votes for the landmarks most like it, with a weight: how much nearer their descriptors are than the
next nearest. Votes for a view count if one similarity maps their keypoints to where the view saw the landmarks. A dozen
right ones among a thousand are enough: what else a picture shows votes for views all over the index, here and there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Camera, Float64, Int64
from engine.pictures.camera.camera_motion import project, swung
from engine.pictures.camera.config import CONFIG
from engine.pictures.landmarks.config import CONFIG as MATCHING
from engine.pictures.landmarks.keypoints import Keypoints
from engine.pictures.landmarks.landmark_set import Landmarks

_CONFIG = CONFIG.votes


@dataclass(frozen=True, eq=False)
class VotedView:
    """A view that may show what a picture shows."""

    loudness: float  # of the votes that agree
    camera: Camera  # of the picture, standing where the view's stood
    keypoints: Int64  # (M,) of these votes
    landmarks: Int64  # (M,)


def vote_for_views(
    keypoints: Keypoints, landmarks: Landmarks, cameras: Sequence[Camera], size: tuple[int, int]
) -> list[VotedView]:
    """The views that a picture of this size (width, height) is voted to show, the loudest first. `cameras` are those
    that the landmarks were seen from.
    """
    if len(landmarks) <= _CONFIG.nearest or not len(keypoints):
        return []
    nearest, gain = _neighbors(keypoints.descriptors, landmarks.descriptors)
    spots = np.repeat(keypoints.points, _CONFIG.nearest, axis=0)
    views = landmarks.views[nearest].astype(np.int64)
    places = np.empty((len(nearest), 2))
    for view, camera in enumerate(cameras):
        mine = views == view
        places[mine] = project(landmarks.points[nearest[mine]].astype(np.float64), camera)
    names, loudness, maps = agreement_of_views(views, spots, places, gain)
    found = []
    for n in np.argsort(-loudness, kind="stable")[: int((loudness > 0).sum())]:
        a, b, c, d = maps[n]
        off = (spots @ (1, 1j)) * complex(a, b) + complex(c, d) - places @ (1, 1j)
        reach = _CONFIG.reach * _CONFIG.tolerance * min(1.0, np.hypot(a, b)) ** 0.5
        agreeing = np.flatnonzero((views == names[n]) & (np.abs(off) < reach))
        camera = _camera(cameras[names[n]], maps[n], size)
        found.append(VotedView(float(loudness[n]), camera, agreeing // _CONFIG.nearest, nearest[agreeing]))
    return found


@parallel_kernel
def _nearest(products, squares, near, distance, call):  # type: ignore[no-untyped-def]
    """Of each row, the targets of least `distance` but for the query's own square, the first of equal ones first."""
    for k in share_of(len(products), call):
        for n in range(len(squares)):
            off = squares[n] - np.float32(2.0) * products[k, n]
            if off < distance[k, -1]:
                place = distance.shape[1] - 1
                while place > 0 and off < distance[k, place - 1]:
                    distance[k, place], near[k, place] = distance[k, place - 1], near[k, place - 1]
                    place -= 1
                distance[k, place], near[k, place] = off, n


def _neighbors(queries: npt.NDArray[np.uint8], targets: npt.NDArray[np.uint8]) -> tuple[Int64, Float64]:
    """The nearest targets of each query, in one row, and how much nearer each is than the next one, 0 to 1."""
    # Sums of whole numbers below 2^24 are exact, whatever the machine.
    query, target = queries.astype(np.float32), targets.astype(np.float32)
    own, squares = (np.einsum("ij,ij->i", each, each) for each in (query, target))
    near = np.zeros((len(query), _CONFIG.nearest + 1), dtype=np.int64)
    distance = np.full(near.shape, np.inf, dtype=np.float32)
    for low in range(0, len(query), MATCHING.chunk):
        rows = slice(low, low + MATCHING.chunk)
        _nearest(query[rows] @ target.T, squares, near[rows], distance[rows])
    away = np.sqrt(distance + own[:, None], dtype=np.float64)
    gains = 1.0 - away[:, : _CONFIG.nearest] / np.maximum(away[:, _CONFIG.nearest :], 1e-12)
    return near[:, : _CONFIG.nearest].reshape(-1), gains.reshape(-1)


def _camera(view: Camera, carried: Float64, size: tuple[int, int]) -> Camera:
    """The camera of a picture of which the view shows what the map `carried` (4,) takes there."""
    turn, shift = complex(carried[0], carried[1]), complex(carried[2], carried[3])
    middle = view.K[:2, 2]
    place = (complex(*middle) - shift) / turn
    scale = 1.0 / abs(turn)
    return swung(view, middle, np.array([place.real, place.imag]), -float(np.angle(turn)), scale, size[::-1])


MOST = 64
"""Votes of a view that are looked at, the loudest: a mask of bits holds who was counted."""
APART, TOLERANCE = CONFIG.votes.apart, CONFIG.votes.tolerance
SMALLEST, LARGEST = CONFIG.votes.sizes


@inlined
def _reach(a, b):  # type: ignore[no-untyped-def]
    """Squared error that is allowed, pixels of the view."""
    return TOLERANCE * TOLERANCE * min(1.0, math.sqrt(a * a + b * b))


@inlined
def _fitted(carried, begin, end, x, y, u, v, gain):  # type: ignore[no-untyped-def]
    """Moves a map (4,) to the one that carries what it carries with the least squares of errors."""
    a, b, c, d = carried
    tolerance = _reach(a, b)
    total, mx, my, mu, mv, square, along, across = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(begin, end):
        off_u, off_v = a * x[k] - b * y[k] + c - u[k], b * x[k] + a * y[k] + d - v[k]
        if off_u * off_u + off_v * off_v <= tolerance:
            g = gain[k]
            total += g
            mx, my, mu, mv = mx + g * x[k], my + g * y[k], mu + g * u[k], mv + g * v[k]
            square += g * (x[k] * x[k] + y[k] * y[k])
            along += g * (u[k] * x[k] + v[k] * y[k])
            across += g * (v[k] * x[k] - u[k] * y[k])
    square -= (mx * mx + my * my) / total
    along -= (mu * mx + mv * my) / total
    across -= (mv * mx - mu * my) / total
    a, b = along / square, across / square
    carried[0], carried[1] = a, b
    carried[2], carried[3] = (mu - a * mx + b * my) / total, (mv - b * mx - a * my) / total


@parallel_kernel
def _agreements(starts, x, y, u, v, spot, place, gain, best, maps, call):  # type: ignore[no-untyped-def]
    """best (V,) of each slice of votes: the loudest sum that one map of (x, y) to (u, v) carries over, each spot and
    each place counted once; and those maps (V, 4)."""
    for n in share_of(len(starts) - 1, call):
        begin, end = starts[n], starts[n + 1]
        most = 0.0
        for i in range(begin, end):
            for j in range(i + 1, end):
                dx, dy, du, dv = x[j] - x[i], y[j] - y[i], u[j] - u[i], v[j] - v[i]
                here, there = dx * dx + dy * dy, du * du + dv * dv
                if here < APART * APART or there < APART * APART:
                    continue
                if there < SMALLEST * SMALLEST * here or there > LARGEST * LARGEST * here:
                    continue
                a, b = (du * dx + dv * dy) / here, (dv * dx - du * dy) / here
                tolerance = _reach(a, b)
                total = 0.0
                spots, places = np.uint64(0), np.uint64(0)
                for k in range(begin, end):
                    off_u = a * (x[k] - x[i]) - b * (y[k] - y[i]) + u[i] - u[k]
                    off_v = b * (x[k] - x[i]) + a * (y[k] - y[i]) + v[i] - v[k]
                    if off_u * off_u + off_v * off_v > tolerance:
                        continue
                    one = np.uint64(1)
                    mine, its = one << np.uint64(spot[k]), one << np.uint64(place[k])
                    if (spots & mine) != np.uint64(0) or (places & its) != np.uint64(0):
                        continue
                    spots |= mine
                    places |= its
                    total += gain[k]
                if total > most:
                    most = total
                    maps[n, 0], maps[n, 1] = a, b
                    maps[n, 2], maps[n, 3] = u[i] - a * x[i] + b * y[i], v[i] - b * x[i] - a * y[i]
        best[n] = most
        if most > 0.0:
            _fitted(maps[n], begin, end, x, y, u, v, gain)


def agreement_of_views(view: Int64, spots: Float64, places: Float64, gain: Float64) -> tuple[Int64, Float64, Float64]:
    """The views (V,) that were voted for, ascending, how much of the votes for each agrees (V,), and the maps (V, 4)
    that they agree on: a, b, c, d of u = a x - b y + c, v = b x + a y + d.

    Parameters
    ----------
    view : (N,)
        For which each vote is.
    spots, places : (N, 2)
        x, y of the keypoint in the picture, and of the landmark in the view, pixels.
    gain : (N,)
        How loud it is.
    """
    order = np.lexsort((-gain, view))
    names, begin = np.unique(view[order], return_index=True)
    rank = np.arange(len(order)) - np.repeat(begin, np.diff(np.append(begin, len(order))))
    order = order[rank < MOST]
    begin = np.append(np.unique(view[order], return_index=True)[1], len(order)).astype(np.int64)
    x, y = np.ascontiguousarray(spots[order].T)
    u, v = np.ascontiguousarray(places[order].T)
    best, maps = np.zeros(len(names)), np.zeros((len(names), 4))
    _agreements(begin, x, y, u, v, _numbered(x, y, begin), _numbered(u, v, begin), gain[order], best, maps)
    return names, best, maps


def _numbered(x: Float64, y: Float64, starts: Int64) -> Int64:
    """(N,) within each slice: the same number for points within about three pixels of each other."""
    slot = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    cell = np.stack([slot, np.floor(x / 3.0), np.floor(y / 3.0)], axis=1).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)  # rising with the slice
    number = number.reshape(-1)
    first = np.full(len(starts) - 1, np.iinfo(np.int64).max)
    np.minimum.at(first, slot, number)
    return np.asarray(number - first[slot])
