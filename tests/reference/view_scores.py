"""Slow twin of `engine.pictures.camera.view_scores`."""

import numpy as np


def score(responses, points, directions, place, roll, radius, bins):
    """Sum of responses (bins, h, w) at the points of a view, over the root of how many lie inside.

    `points` (P, 2) from their middle in units of their spread, `directions` (P,) radians; `place` x, y of the middle,
    pixels; `roll` radians; `radius` pixels.
    """
    _, height, width = responses.shape
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    total, inside = 0.0, 0
    for point, direction in zip(points.astype(np.float64) * radius @ turn.T, directions, strict=True):
        column, row = np.floor(point + 0.5).astype(int) + place
        if 0 <= row < height and 0 <= column < width:
            total += responses[int(np.floor((direction + roll) * bins / np.pi + 0.5)) % bins, row, column]
            inside += 1
    return total / np.sqrt(max(inside, 1)), inside


def strongest_apart(strength, count, free, reach):
    """x, y of at most `count` free pixels of strength above 0, the strongest first, each more than `reach` along an
    axis from those before."""
    chosen = []
    for row, column in sorted(np.argwhere((strength > 0) & free).tolist(), key=lambda place: -strength[tuple(place)]):
        if len(chosen) < count and all(max(abs(row - y), abs(column - x)) > reach for x, y in chosen):
            chosen.append((column, row))
    return chosen
