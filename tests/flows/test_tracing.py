"""Collusion names: every copy that took part, and no other, whatever the colluders do with their copies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.trace.tracing import trace_images, trace_model
from engine.flows.verify.search import VerifyConfig, verify_model
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.bench.truth import innocent_copies
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.sim.adversaries.collusion import collude
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel
from engine.raster import render
from engine.watermark.rates import Attested
from engine.watermark.statistics import z_threshold
from tests.flows.conftest import FiveCopies
from tests.parameters import few

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_renders")]

CONFIG = profile("fast", landmark_views=0, views=3, view_size=160)
INNOCENT = 300
MODEL = VerifyConfig(route="model")


@dataclass(frozen=True)
class Copies:
    models: list[GaussianModel]
    opened: list[OpenedRecord]
    others: list[OpenedRecord]

    def together(self, count: int, rule: str = "mean") -> GaussianModel:
        return collude(self.models[0], rule, np.random.default_rng(1), others=self.models[1:count])


@pytest.fixture(scope="module")
def copies(five_copies: FiveCopies) -> Copies:
    """Five copies of one asset, and the records of copies that nobody leaked."""
    return Copies(
        five_copies.models, five_copies.opened, list(innocent_copies(five_copies.opened[0], bench_key(5), INNOCENT))
    )


@pytest.mark.parametrize(
    "rule",
    few(
        ["mean", "minmax", "randneg", "patches"],
        ["mean", "median", "min", "max", "minmax", "randneg", "interleave", "patches"],
    ),
)
def test_each_of_five_is_named_and_no_innocent(copies: Copies, rule: str) -> None:
    answer = trace_model(copies.together(5, rule), [*copies.others[: INNOCENT // 3], *copies.opened], MODEL)
    assert {f.copy for f in answer.named} == {f"buyer {i}" for i in range(5)}
    assert all(f.log10_false_claim <= -9 for f in answer.named)
    assert max(abs(f.z) for f in answer.findings if not f.named) < 5


def test_one_reading_gives_what_single_verifications_give(copies: Copies) -> None:
    suspect = model_attack("similarity").apply(copies.together(3), 4.0, rng=2)
    answer = trace_model(suspect, copies.opened, MODEL)
    z = {f.copy: f.z for f in answer.findings}
    for opened in copies.opened[:3]:
        assert z[opened.copy] == pytest.approx(verify_model(suspect, opened, MODEL).claim.copy_z, rel=1e-9)
    assert [f.copy for f in answer.named] == [f.copy for f in answer.findings[:3]]
    assert {f.copy for f in answer.named} == {"buyer 0", "buyer 1", "buyer 2"}
    assert all(f.derived_fraction > 0.9 for f in answer.findings)


def test_every_record_and_route_is_a_try(copies: Copies) -> None:
    alone = trace_model(copies.models[0], copies.opened[:1], MODEL)
    among = trace_model(copies.models[0], copies.opened + copies.others, VerifyConfig(route="auto"))
    assert (alone.tries, among.tries) == (12, 18 * (5 + INNOCENT))
    assert among.z_threshold == z_threshold(1e-9, among.tries) > alone.z_threshold
    assert among.named[0].log10_false_claim == pytest.approx(
        alone.named[0].log10_false_claim + np.log10(among.tries / 12)
    )
    counted = trace_model(copies.models[0], copies.opened, VerifyConfig(route="model", tries=10**6))
    assert counted.tries == 10**6


def test_an_unmarked_model_names_nobody_by_any_route(copies: Copies, small_plant: GaussianModel) -> None:
    answer = trace_model(small_plant, copies.opened + copies.others)
    assert answer.named == ()
    assert "render" in answer.seconds_by_stage


def test_pictures_of_an_average_name_each_copy(copies: Copies) -> None:
    cameras = [c.resized(256, 256) for c in copies.opened[0].cameras]
    pictures = [to_8_bit(render(copies.together(3), c)) for c in cameras]
    answer = trace_images(pictures, copies.opened + copies.others, cameras=cameras)
    assert {f.copy for f in answer.named} == {"buyer 0", "buyer 1", "buyer 2"}
    assert answer.tries == 2 * 6 * (5 + INNOCENT)


def test_a_name_that_verification_would_leave_open_says_why(copies: Copies) -> None:
    stamped = Attested("2026-01-01T00:00:00+00:00", "a service", drawn=True)
    told = []
    for side in (48, 128):
        camera = copies.opened[0].cameras[0].resized(side, side)
        picture = to_8_bit(render(copies.models[0], camera))
        plain, drawn = (
            trace_images([picture], [replace(copies.opened[0], attested=each)], cameras=[camera])
            for each in (None, stamped)
        )
        between = [f for f in plain.named if f.log10_false_claim > -128 * np.log10(2)]
        assert len(plain.notes) == len(drawn.notes) + (len(between) > 0)
        told.append(len(between))
    assert len(set(told)) == 2, "both cases were met"


def test_assets_of_one_owner_are_read_apart(copies: Copies, small_plant: GaussianModel) -> None:
    key = bench_key(5)
    other = small_plant.with_(means=small_plant.means[:, [1, 0, 2]] * [1, 2, 1])
    record = embed(other, key, original_sha256="22" * 32, bits=16, config=CONFIG, copy="elsewhere").record
    elsewhere = open_record(record.to_bytes(key), key)
    answer = trace_model(copies.models[2], [elsewhere, *copies.opened], MODEL)
    assert [f.copy for f in answer.named] == ["buyer 2"]
    assert answer.tries == 72


def test_what_cannot_be_traced_is_refused(copies: Copies) -> None:
    with pytest.raises(InputError, match="no record"):
        trace_model(copies.models[0], [])
    with pytest.raises(InputError, match="given twice"):
        trace_model(copies.models[0], [copies.opened[0], copies.opened[0]])
    with pytest.raises(InputError, match="no picture"):
        trace_images([], copies.opened)
