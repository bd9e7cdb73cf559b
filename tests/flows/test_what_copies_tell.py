"""What two copies differ in tells nothing of the layer that they share: neither a sign nor a border of its cells."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from engine.compress.cells import cell_features
from engine.flows.records.opened_record import owner_displacements
from engine.flows.views.camera_rig import measure_extent
from engine.model import Bool, Float64
from tests.flows.conftest import FiveCopies

CLASSES = 40
"""Classes of pairs that lie equally near each other, in place and color, which everybody sees."""


def auc(score: Float64, positive: Bool) -> float:
    """Area under the ROC curve of a score."""
    ranks, count = scipy.stats.rankdata(score), int(positive.sum())
    return float((ranks[positive].sum() - count * (count + 1) / 2) / (count * (len(score) - count)))


def test_no_sign_of_the_shared_layer_is_told(five_copies: FiveCopies) -> None:
    one, two = five_copies.models[:2]
    owner = owner_displacements(five_copies.opened[0])
    assert owner[1] is not None
    colors = (one.sh[:, 0] - two.sh[:, 0]).reshape(-1), owner[0].reshape(-1)
    sizes = (one.log_scales - two.log_scales).reshape(-1), owner[1].reshape(-1, 2, 3)[:, 1].reshape(-1)
    for apart, layer in (colors, sizes):
        shown = (apart != 0) & (layer != 0)
        assert auc(apart[shown].astype(np.float64), layer[shown] > 0) == pytest.approx(0.5, abs=0.02)


def test_no_border_of_the_shared_cells_is_told(five_copies: FiveCopies) -> None:
    """Beyond what place and color tell, by which public cells are made."""
    one, two, opened = *five_copies.models[:2], five_copies.opened[0]
    model = opened.reference
    near = scipy.spatial.cKDTree(model.means).query(model.means, k=7)[1][:, 1:]
    i, j = np.repeat(np.arange(len(model)), 6), near.reshape(-1)
    apart = (one.sh[:, 0] - two.sh[:, 0]).astype(np.float64)
    size = np.linalg.norm(apart[i], axis=1) + np.linalg.norm(apart[j], axis=1)
    alike = -np.linalg.norm(apart[i] - apart[j], axis=1) / np.maximum(size, 1e-12)
    labels = opened.layout.labels[0]
    together = labels[i] == labels[j]
    features = cell_features(model, measure_extent(model).radius).astype(np.float64)
    public = np.linalg.norm(features[i] - features[j], axis=1)
    classes = np.digitize(public, np.quantile(public, np.arange(1, CLASSES) / CLASSES))
    found = [auc(alike[classes == k], together[classes == k]) for k in range(CLASSES)]
    assert np.mean(found) < 0.52
