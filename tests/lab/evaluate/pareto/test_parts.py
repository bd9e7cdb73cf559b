"""Fronts, points, sums and peers with known answers."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import pytest

from engine.flows.embed.profiles import AUTO, profile
from engine.lab.evaluate.pareto.pareto_cells import ATTACKS
from engine.lab.evaluate.pareto.pareto_charts import draw_bytes_and_seconds, peers
from engine.lab.evaluate.pareto.pareto_sums import cheapest, pareto_front, results
from engine.lab.evaluate.pareto.points import BASE, Point, config_of, points
from engine.lab.evaluate.published import Published, read_published


def test_the_front_is_what_nothing_beats() -> None:
    #         cheap and poor, dear and rich, beaten, as good but dearer, the cheapest of equals
    values = [(1.0, 5.0), (4.0, 9.0), (3.0, 4.0), (5.0, 9.0), (2.0, 7.0)]
    assert pareto_front(values) == [0, 4, 1]
    assert pareto_front([(1.0, 1.0), (1.0, 3.0)]) == [1]
    assert pareto_front([]) == []


def test_points_turn_one_knob_and_survive_json() -> None:
    every = points(quick=False)
    assert every[0] == BASE
    assert len({point.name for point in every}) == len(every)
    assert [Point(**json.loads(json.dumps(asdict(point)))) for point in every] == every
    for point in every:
        if point.axis not in ("profile", "corner", "auto", "SH degree", "bits"):
            assert len(point.changes) == 1, point


def test_settings_of_points() -> None:
    assert config_of(BASE) == profile("fast")
    pruned = config_of(Point("p", "pruning", changes={"budget": 40.0}))
    assert pruned.prune.budget_db == 40.0
    assert config_of(Point("c", "cells", changes={"cells": 1024})).quantize.cells == 1024
    assert config_of(Point("s", "corner", "strong"), landmark_views=0).landmark_views == 0


def test_what_changes_the_delivered_model_has_landmarks_of_its_own() -> None:
    own = {point.name for point in points(quick=False) if not point.shares_landmarks}
    assert {"fast", "auto", "SH-0", "pruning-35.0", "smallest", "landmarks-16", "leanest"} <= own
    assert own.isdisjoint({"balanced", "views-2", "cells-1024", "bits-256", "fidelity-53.0"})


def row(point: Point, seconds: float, z: float, *, bits: int = 32, db: float = 46.0) -> dict[str, Any]:
    base = {"z": 99.0, "bit_accuracy": 1.0, "matching": 32, "read": 32, "log10_false_claim": -100.0}
    attacks: dict[str, Any] = {trial.label: dict(base) for trial in ATTACKS}
    attacks["picture, JPEG 10"] |= {"z": z, "matching": bits}
    return {
        "point": asdict(point),
        "stages": {"look": seconds, "landmarks": 0.0 if point != BASE else 4.0},
        "cpu_seconds": [seconds + (7.0 if point == BASE else 0.0), seconds, seconds],
        "shares_landmarks": point.shares_landmarks,
        "attacks": attacks,
        "psnr_held_out": [50.0, db],
        "landmark_views": config_of(point).landmark_views,
    }


def test_sums_and_the_cheapest_that_will_do() -> None:
    lean = Point("lean", "views", changes={"views": 2})
    thin, blind = (Point("l", "l", changes={"landmark_views": views}) for views in (16, 0))
    rows = [
        row(BASE, 2.0, 20.0),
        row(lean, 1.0, 20.0, db=41.0),
        row(Point("a", "cells", changes={"cells": 1024}), 1.5, 15.0),
        row(Point("b", "cells", changes={"cells": 2048}), 0.5, 7.0),
        row(blind, 0.1, 30.0),
        row(thin, 0.2, 30.0),
        {"refused": "no"},
    ]
    found = results(rows)
    assert [result.embed_seconds for result in found] == [6.0, 5.0, 5.5, 4.5, 0.1, 0.2]
    assert [result.cpu_seconds for result in found] == [9.0, 8.0, 8.5, 7.5, 0.1, 0.2]
    assert found[0].worst_attack == "picture, JPEG 10"
    assert found[0].picture_z == 20.0
    best = cheapest(found, margin=1.5, least_db=45.0)
    assert best is not None
    assert best.point.name == "a", "too dim, too weak, and hardly or never findable ones are cheaper"
    assert cheapest(found, margin=10.0, least_db=45.0) is None
    spoilt = results([row(BASE, 2.0, 20.0, bits=31)])
    assert spoilt[0].matching == spoilt[0].read - 1
    assert spoilt[0].picture_bits == pytest.approx(100 * 31 / 32)
    assert cheapest(spoilt, margin=1.0, least_db=45.0) is None


def test_bytes_and_seconds_against_fidelity_name_what_auto_chose() -> None:
    allowed = [Point(f"allowed-{db:g}", "allowance", AUTO, {"budget": db}) for db in (40.0, 30.0)]
    rows = [row(point, 2.0, 20.0 + n) for n, point in enumerate([BASE, *allowed])]
    for base, size, quality in zip(rows, (4e6, 3e6, 1e6), (47.0, 39.0, 29.5), strict=True):
        base |= {"sog_bytes": size, "psnr_total_held_out": quality}
    drawn = draw_bytes_and_seconds(results(rows))
    left, right = drawn.axes
    assert [text.get_text() for text in left.texts] == ["30, z 22", "40, z 21"]
    assert left.get_title() == "Down to 25 % of the bytes by what loss is allowed"
    (line,) = (line for line in left.lines if line.get_label() == "auto, loss allowed")
    assert (list(line.get_xdata()), list(line.get_ydata())) == ([1.0, 3.0], [29.5, 39.0])
    (line,) = (line for line in right.lines if line.get_label() == "auto, loss allowed")
    assert list(line.get_xdata()) == [2.0, 2.0]
    assert draw_bytes_and_seconds(results(rows[:1])).axes[0].get_title() == "What the delivered file takes"


def test_peers_are_at_their_worst_picture() -> None:
    def said(method: str, what: str, value: float, conditions: str, blind: bool = True) -> Published:
        return Published(method, "v", 2026, what, value, "", conditions, blind, "GPU", "s")

    some = [
        said("A", "embedding time", 60.0, ""),
        said("A", "bit accuracy", 99.0, "32 bits, no attack"),
        said("A", "bit accuracy", 91.0, "32 bits, JPEG 10"),
        said("A", "bit accuracy", 93.0, "32 bits, noise 0.1"),
        said("A", "bit accuracy", 50.0, "32 bits, clone 50 %"),
        said("B", "PSNR", 40.0, "", blind=False),
    ]
    assert peers(some, "bits") == [("A, GPU", 60.0, 91.0, True)]
    assert peers(some, "PSNR") == []
    assert len(peers(read_published(), "bits")) >= 5
