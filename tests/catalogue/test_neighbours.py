from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.catalogue import catalogue as catalogues
from engine.catalogue.catalogue import Neighbors
from engine.catalogue.config import CONFIG
from engine.model import Float32


def crowd(seed: int = 0, assets: int = 6, each: int = 50) -> list[Float32]:
    rng = np.random.default_rng(seed)
    return [rng.normal(size=(each, 8)).astype(np.float32) for _ in range(assets)]


def filled(vectors: list[Float32]) -> Neighbors:
    made = Neighbors.learnt(np.concatenate(vectors), sum(map(len, vectors)), "Flat")
    for number, part in enumerate(vectors):
        made.add(number, part)
    return made


def test_votes_are_the_nearest_ones_less_the_next() -> None:
    vectors = crowd()
    whole = np.concatenate(vectors)
    queries = crowd(1, 1, 7)[0]
    near = filled(vectors)
    votes = near.votes(queries)
    for query, asked in enumerate(queries):
        distance = np.linalg.norm(whole - asked, axis=1)
        order = np.argsort(distance)
        mine = votes.query == query
        assert set(votes.row[mine]) == set(order[: CONFIG.nearest])
        for row, gain in zip(votes.row[mine], votes.gain[mine], strict=True):
            assert gain == pytest.approx(1 - distance[row] / distance[order[CONFIG.nearest]], abs=1e-4)


def test_a_query_speaks_for_an_asset_once() -> None:
    vectors = crowd()
    vectors[3][:5] = vectors[3][0]  # five of one
    near = filled(vectors)
    votes = near.votes(vectors[3][:1])
    assert near.by_asset(votes, 6)[3] == pytest.approx(1.0, abs=1e-3)


def test_many_vectors_are_sorted_into_lists_and_found_all_the_same(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(catalogues, "CONFIG", replace(CONFIG, few=1000))
    vectors = crowd(2, 40, 100)
    near = filled(vectors)
    assert hasattr(near._index, "nprobe")
    rng = np.random.default_rng(3)
    noisy = vectors[17] + rng.normal(0, 0.1, vectors[17].shape).astype(np.float32)
    assert int(np.argmax(near.by_asset(near.votes(noisy), 40))) == 17
    near.save(tmp_path / "field")
    for growing in (False, True):
        again = Neighbors.load(tmp_path / "field", growing=growing)
        np.testing.assert_array_equal(again.votes(noisy).row, near.votes(noisy).row)
    again.add(40, noisy)
    assert int(np.argmax(again.by_asset(again.votes(noisy), 41))) == 40
    assert len(again) == len(near) + 100


def test_nothing_and_too_few_speak_without_failing() -> None:
    none = Neighbors.learnt(np.zeros((0, 8), np.float32), 0, "Flat")
    assert len(none.votes(np.zeros((3, 8), np.float32)).row) == 0
    few = filled([np.eye(8, dtype=np.float32)[:2]])
    votes = few.votes(np.eye(8, dtype=np.float32)[:1])
    assert list(zip(votes.row, votes.gain, strict=True)) == [(0, 1.0)]  # no yardstick: only what is the same
    assert len(few.votes(np.zeros((0, 8), np.float32)).row) == 0
