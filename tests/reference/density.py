"""HDBSCAN by the book on all pairs: the specification of `engine.lab.sim.adversaries.purification`."""

from __future__ import annotations

import numpy as np


def cluster_by_density(points: np.ndarray, neighbours: int, least: int) -> np.ndarray:
    """Labels by recursive splitting: at each density level, the connected parts of the points that reach it."""
    n = len(points)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    core = np.sort(distance, axis=1)[:, neighbours]
    reach = np.maximum(distance, np.maximum(core[:, None], core[None])) + 1e-6 * distance

    def parts(members: np.ndarray, below: float) -> list[np.ndarray]:
        """Connected parts of the members by edges shorter than `below`."""
        left, found = set(members.tolist()), []
        while left:
            front = [left.pop()]
            part = list(front)
            while front:
                node = front.pop()
                near = [other for other in left if reach[node, other] < below]
                left.difference_update(near)
                front += near
                part += near
            found.append(np.array(sorted(part)))
        return found

    def grow(members: np.ndarray, birth: float) -> tuple[float, list[np.ndarray]]:
        """Best stability under a cluster, and the clusters that have it."""
        everyone, stability, now = members, 0.0, members
        while True:
            inner = reach[np.ix_(now, now)]
            tree_longest = _longest_needed(inner)
            split = parts(now, tree_longest)
            big = [part for part in split if len(part) >= least]
            level = 1.0 / tree_longest
            lost = len(now) - (len(big[0]) if len(big) == 1 else 0)
            stability += lost * (level - birth)
            if len(big) == 1:
                now = big[0]
                continue
            below = [grow(part, level) for part in big]
            rest = sum(value for value, _ in below)
            if stability >= rest:
                return stability, [everyone]
            return rest, [cluster for _, clusters in below for cluster in clusters]

    def _longest_needed(inner: np.ndarray) -> float:
        """Longest edge of the minimum spanning tree (Prim)."""
        count = len(inner)
        best = inner[0].copy()
        used = np.zeros(count, dtype=bool)
        used[0] = True
        longest = 0.0
        for _ in range(count - 1):
            best[used] = np.inf
            node = int(np.argmin(best))
            longest = max(longest, float(best[node]))
            used[node] = True
            best = np.minimum(best, inner[node])
        return longest

    labels = np.full(n, -1)
    everything = np.arange(n)
    now = everything
    while True:  # the root is no cluster: follow it to its first split
        longest = _longest_needed(reach[np.ix_(now, now)])
        big = [part for part in parts(now, longest) if len(part) >= least]
        if len(big) != 1:
            break
        now = big[0]
    clusters = [cluster for part in big for cluster in grow(part, 1.0 / longest)[1]]
    for number, cluster in enumerate(clusters):
        labels[cluster] = number
    return labels
