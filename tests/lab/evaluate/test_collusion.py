"""Collusion study: one placement says what verification and tracing say by themselves."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest

from engine.errors import InputError
from engine.flows.embed.profiles import profile
from engine.flows.trace.tracing import trace_model
from engine.flows.verify.search import VerifyConfig, verify_model
from engine.lab.evaluate.bench.truth import FORMS, innocent_copies, measure_collusion, read_copies
from engine.lab.evaluate.marked_scene import bench_key, mark_copies
from engine.lab.sim.attacks import model_attack

TRAIN = str(Path(__file__).parents[2] / "data" / "train_1000.ply")


def test_a_result_is_read_as_verification_and_tracing_read_it() -> None:
    copies = mark_copies(TRAIN, profile("fast", landmark_views=0), ["buyer 0", "buyer 1", "buyer 2"])
    given = [copy.marked for copy in copies]
    suspect = model_attack("collude").apply(given[0], "mean", rng=0, others=given[1:2])
    opened = [copy.opened for copy in copies[:2]]
    records = [*opened, *islice(innocent_copies(opened[0], bench_key(0), 3), 3)]
    row, config = read_copies(suspect, records), VerifyConfig(route="model")
    claim, traced = verify_model(suspect, opened[0], config).claim, trace_model(suspect, records, config)
    guilty = [finding for finding in traced.findings if finding.copy.startswith("buyer")]
    assert (row["z"], row["verdict"]) == (claim.z, claim.verdict.value)
    assert row["z_threshold"] == traced.z_threshold
    assert row["z_least"] == min(finding.z for finding in guilty)
    assert (row["named"], row["innocents"], row["innocents_named"]) == (len(traced.named), 3, 0)
    assert row["named"] > 0


@pytest.mark.slow
def test_settings_choose_formats_and_numbers() -> None:
    rows = measure_collusion(TRAIN, 0, 10, ["splat", "3"])
    assert {(row["format"], row["colluders"]) for row in rows} == {("splat", 3)}
    assert sum(row["innocents"] for row in rows) == 10
    with pytest.raises(InputError, match="got 'obj'"):
        measure_collusion(TRAIN, 0, 10, [*FORMS, "obj"])
