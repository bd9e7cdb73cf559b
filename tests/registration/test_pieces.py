"""A suspect that holds several pieces of the reference: each gets a transform of its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.model import ATTRIBUTES, GaussianModel
from engine.numerics.similarity import mirror_model, transform_model
from engine.registration.pieces import register_pieces
from engine.registration.registration_search import Registration, register
from tests.watermark.ball import ball_model

REFERENCE = ball_model(1000)
TURN = Rotation.from_rotvec([0.3, 1.0, 0.2]).as_matrix()


def moved(rows: np.ndarray, scale: float, at: float, *, mirrored: bool = False) -> GaussianModel:
    part = REFERENCE.take(rows)
    return transform_model(mirror_model(part) if mirrored else part, scale, TURN, np.array([at, 0.0, 0.0]))


def together(*models: GaussianModel) -> GaussianModel:
    return models[0].with_(**{name: np.concatenate([getattr(m, name) for m in models]) for name in ATTRIBUTES})


def exact(piece: Registration, rows: np.ndarray, first: int) -> None:
    hits = np.flatnonzero(piece.matches >= 0)
    assert ((hits >= first) & (hits < first + len(rows))).all()
    assert len(hits) > 0.95 * len(rows)
    np.testing.assert_array_equal(piece.matches[hits], rows[hits - first])
    assert piece.derived_fraction == pytest.approx(len(hits) / len(REFERENCE))


def test_two_copies_one_of_them_mirrored() -> None:
    rows = np.arange(len(REFERENCE))
    suspect = together(moved(rows, 0.5, 4.0), moved(rows, 0.7, -4.0, mirrored=True))
    pieces = sorted(register_pieces(REFERENCE, suspect), key=lambda piece: piece.mirrored)
    assert [piece.mirrored for piece in pieces] == [False, True]
    assert [piece.scale for piece in pieces] == [pytest.approx(1 / 0.5, rel=1e-4), pytest.approx(1 / 0.7, rel=1e-4)]
    for piece, first in zip(pieces, (0, len(rows)), strict=True):
        exact(piece, rows, first)


@pytest.mark.long
def test_a_field_of_maps_gives_way_to_rigid_pieces() -> None:
    """What `register` takes for one bent thing is two."""
    left = REFERENCE.means[:, 0] < 0
    halves = np.flatnonzero(left), np.flatnonzero(~left)
    suspect = together(moved(halves[0], 1.0, 0.4), moved(halves[1], 1.0, -2.0))
    pieces = sorted(register_pieces(REFERENCE, suspect, first=register(REFERENCE, suspect)), key=lambda p: -p.t[0])
    assert len(pieces) == 2
    assert not any(piece.deformed for piece in pieces)
    placed = [np.median(piece.matches[piece.matches >= 0] % len(REFERENCE)) for piece in pieces]
    assert len(set(placed)) == 2


def test_noise_leaves_no_second_piece() -> None:
    """Rows that the first registration left over lie where it lies: they are of the same piece."""
    rng = np.random.default_rng(0)
    noisy = REFERENCE.with_(
        means=(REFERENCE.means + rng.normal(0, 0.01, REFERENCE.means.shape) * rng.exponential(1.0, (1000, 1))).astype(
            np.float32
        )
    )
    suspect = noisy.take(rng.permutation(1000))
    first = register(REFERENCE, suspect)
    few = np.where(rng.random(1000) < 0.3, -1, first.matches).astype(np.int32)  # as if it had left a third over
    lost = Registration(first.scale, first.R, first.t, few, np.where(few >= 0, first.match_quality, 0), 0.7, True, 1)
    (piece,) = register_pieces(REFERENCE, suspect, first=lost)
    assert (piece.matches >= 0).sum() > (few >= 0).sum() + 150
    assert piece.derived_fraction > 0.85


def test_nothing_of_it_and_nothing_asked() -> None:
    (piece,) = register_pieces(REFERENCE, ball_model(100, seed=9))
    assert not piece.found
    with pytest.raises(InputError, match="at least one"):
        register_pieces(REFERENCE, REFERENCE, most=0)
