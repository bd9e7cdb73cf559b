"""Purification by contribution: GSPure's idea (AAAI 2026), a hidden thing shows as Gaussians that serve no view.

Clusters are found by density: HDBSCAN (Campello, Moulavi and Sander 2013) on a graph of nearest neighbors.

1. Core distance of a point: distance to its `neighbors`-th neighbor. 2. Minimum spanning tree of the mutual
reachability max(core_a, core_b, d_ab). 3. Single linkage: cutting the tree from the longest edge down. 4. Condensing:
a split counts when both parts hold `least` points. 5. The clusters of greatest stability are selected.

Step 2 uses the edges to `GRAPH` nearest neighbors only, not all pairs: with these a million points take seconds,
and pieces that no edge joins are joined last, at infinite distance.
"""

from collections.abc import Sequence

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attack import Attacks
from engine.lab.sim.model_population import impact
from engine.model import Camera, Float64, GaussianModel, Int64

GRAPH = 16

TIE = 1e-6
"""Share of the plain distance added to mutual reachability: many pairs share a core distance, and a tree must not
hang on the order of equal edges."""


def cluster_by_density(points: Float64, neighbors: int, least: int, graph: int = GRAPH) -> Int64:
    """Label of each of the points (N, D) float64, 0, 1, ... or -1 for noise: (N,) int64.

    Coordinates are of equal importance. A core point has `neighbors` >= 1, a cluster `least` >= 2 points; the spanning
    tree goes by `graph` neighbors, not fewer than make a core point. InputError where a number is out of its range.
    """
    if neighbors < 1 or least < 2 or graph < neighbors:
        raise InputError(f"clusters need neighbors >= 1, least >= 2, graph >= neighbors: {neighbors}, {least}, {graph}")
    n = len(points)
    if n <= max(neighbors, least):
        return np.full(n, -1, dtype=np.int64)
    children, distance, size = _single_linkage(*_spanning_tree(points, neighbors, min(graph, n - 1)), n)
    return _select(children, distance, size, n, least)


def _spanning_tree(points: Float64, neighbors: int, graph: int) -> tuple[Int64, Int64, Float64]:
    """Ends (E,), (E,) and lengths (E,) of the tree's edges, shortest first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import minimum_spanning_tree
    from scipy.spatial import cKDTree

    n = len(points)
    distance, near = cKDTree(points).query(points, k=graph + 1, workers=2)
    core = distance[:, neighbors]
    start = np.repeat(np.arange(n), graph)
    end = near[:, 1:].reshape(-1)
    apart = distance[:, 1:].reshape(-1)
    reach = np.maximum(np.maximum(core[start], core[end]), apart) + TIE * apart
    # Both directions of a pair have one length; a length of zero would be no edge to scipy.
    low, high = np.minimum(start, end), np.maximum(start, end)
    pair, first = np.unique(low * np.int64(n) + high, return_index=True)
    first = first[pair // n != pair % n]
    lengths = np.maximum(reach[first], 1e-300)
    tree = minimum_spanning_tree(coo_matrix((lengths, (low[first], high[first])), shape=(n, n))).tocoo()
    order = np.lexsort((tree.col, tree.row, tree.data))
    return tree.row[order].astype(np.int64), tree.col[order].astype(np.int64), tree.data[order]


def _single_linkage(start: Int64, end: Int64, lengths: Float64, n: int) -> tuple[Int64, Float64, Int64]:
    """Children (n - 1, 2), distances (n - 1,) and sizes (2 n - 1,) of a binary tree over the points."""
    parent = list(range(2 * n - 1))
    size = [1] * n + [0] * (n - 1)
    children = np.empty((n - 1, 2), dtype=np.int64)
    distance = np.full(n - 1, np.inf)

    def top(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    made = 0
    for a, b, length in zip(start.tolist(), end.tolist(), lengths.tolist(), strict=True):
        one, other, node = top(a), top(b), n + made
        children[made], distance[made] = (one, other), length
        parent[one] = parent[other] = node
        size[node] = size[one] + size[other]
        made += 1
    roots = [node for node in range(n + made) if parent[node] == node]
    while len(roots) > 1:  # pieces of a graph that is not connected
        one, other, node = roots.pop(), roots.pop(), n + made
        children[made] = one, other
        parent[one] = parent[other] = node
        size[node] = size[one] + size[other]
        roots.append(node)
        made += 1
    return children, distance, np.array(size, dtype=np.int64)


def _select(children: Int64, distance: Float64, size: Int64, n: int, least: int) -> Int64:
    """Labels of the clusters of greatest stability (excess of mass); the root is none."""
    floor = 1e-6 * float(np.median(distance))  # of equal points, which would outweigh everything
    density = 1.0 / np.maximum(distance, max(floor, 1e-300))  # 0 where pieces were joined
    big = (size >= least).tolist()
    cluster = [0] * (2 * n - 1)  # condensed cluster of each node, from the root down
    fallen = [False] * (2 * n - 1)
    parents, births, stability = [-1], [0.0], [0.0]
    for node in range(2 * n - 2, n - 1, -1):
        mine, level = cluster[node], float(density[node - n])
        pair = children[node - n].tolist()
        split = not fallen[node] and big[pair[0]] and big[pair[1]]
        for child in pair:
            cluster[child] = mine
            fallen[child] = fallen[node]
            if split:
                cluster[child] = len(parents)
                parents.append(mine)
                births.append(level)
                stability.append(0.0)
            if not fallen[node] and (split or not big[child]):  # these points leave the cluster here
                stability[mine] += float(size[child]) * (level - births[mine])
                fallen[child] = not split
    return _labels(parents, stability, cluster[:n])


def _labels(parents: list[int], stability: list[float], cluster: list[int]) -> Int64:
    below = [0.0] * len(parents)  # stability of the best clusters under each
    chosen = [False] * len(parents)
    for c in range(len(parents) - 1, 0, -1):
        chosen[c] = stability[c] >= below[c]
        below[parents[c]] += max(stability[c], below[c])
    label = [-1] * len(parents)
    count = 0
    for c in range(1, len(parents)):  # parents come first: the topmost choice holds
        label[c] = label[parents[c]]
        if label[c] < 0 and chosen[c]:
            label[c] = count
            count += 1
    return np.asarray(np.array(label, dtype=np.int64)[np.array(cluster)])


ATTACKS: Attacks[GaussianModel] = Attacks("model")

NEIGHBORS = 4  # neighbors of a core point: GSPure's second threshold
LEAST_CLUSTER = 32  # fewest Gaussians of a cluster


@ATTACKS.add(
    "remove clusters of Gaussians that contribute little to views",
    "least contribution, means of all",
    0.25,
    (0.01, 0.03, 0.1, 0.25, 0.5, 1.0),
    "(0, inf)",
)
def purify(
    model: GaussianModel, strength: float, rng: np.random.Generator, *, cameras: Sequence[Camera] | None = None
) -> GaussianModel:
    """Gaussians are clustered by position, contribution (`impact` over the cameras' views) and opacity with HDBSCAN.

    A cluster goes when its mean contribution lies below `strength` times the mean of all, and so does a Gaussian in no
    cluster by its own; at least one Gaussian stays. GSPure's threshold is 4 pixels on scenes of its own; ours is
    relative, so that it means the same in every scene (4 pixels are about 0.25 for 100k Gaussians in 24 views of
    256 x 256).
    """
    contribution = impact(model, cameras, rng)
    mean = float(contribution.mean())
    if mean <= 0:
        raise InputError("none of the cameras sees the model")
    relative = contribution / mean
    places = model.means.astype(np.float64) / measure_extent(model).radius
    shown = model.opacities.astype(np.float64)[:, None]
    features = np.column_stack([_even(each) for each in (places, np.log10(relative + 1e-3)[:, None], shown)])
    label = cluster_by_density(features, NEIGHBORS, LEAST_CLUSTER)
    grouped = label >= 0
    clusters = int(label.max(initial=-1)) + 1
    members = np.bincount(label[grouped], minlength=clusters)
    sums = np.bincount(label[grouped], relative[grouped], clusters)
    worth = relative.copy()
    worth[grouped] = (sums / np.maximum(members, 1))[label[grouped]]
    keep = worth >= strength
    keep[int(np.argmax(contribution))] = True
    return model.take(keep)


def _even(values: Float64) -> Float64:
    """(N, D) over one robust spread for all columns: each attribute counts alike."""
    spread = float(np.median(np.abs(values - np.median(values, axis=0))))
    return np.asarray(values / max(spread, 1e-9))
