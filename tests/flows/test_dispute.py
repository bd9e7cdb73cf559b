"""Disputes: inversion, overwriting, copying, back-dating and re-marking are played, and the thief loses each time."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from engine.flows.dispute.dispute import Dispute, Party, settle
from engine.flows.embed.embedding import Embedding, embed
from engine.flows.embed.layer_strengths import add_dc
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import GaussianModel
from engine.present.dispute_text import dispute_page, dispute_words
from engine.present.numerals import PLAIN
from engine.watermark.keys import CHIPS, OwnerKey, signs
from engine.watermark.rates import Attested
from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_renders")]
OWNER, THIEF = bench_key(1), bench_key(666)
QUICK = profile("fast", landmark_views=0, views=3, view_size=200)


def mark(model: GaussianModel, key_number: int, *, said: str = "", attested: str = "", psnr_db: float = 47.0) -> Party:
    """What somebody has who marked this model with this program."""
    key = OWNER if key_number == 1 else bench_key(key_number)
    made = marked_once(model, key, said, psnr_db)
    word = Attested(attested, "a time-stamping service") if attested else None
    return Party(open_record(made.record.to_bytes(key), key, word), made.model)


@cache
def marked_once(model: GaussianModel, key: OwnerKey, said: str, psnr_db: float) -> Embedding:
    config = replace(QUICK, psnr_db=psnr_db)
    return embed(model, key, original_sha256="ab" * 32, config=config, registered_at=said)


@pytest.fixture(scope="module")
def owner(small_plant: GaussianModel) -> Party:
    return mark(small_plant, 1, said="2026-03-01", attested="2026-03-01T00:00:00+00:00")


def lost(owner: Party, thief: Party, *deeds: str) -> Dispute:
    """The dispute, which the thief loses; his deeds are named."""
    found = settle(owner, thief)
    assert found.first == "a"
    assert found.seen == tuple((deed, "b") for deed in deeds)
    assert dispute_words(found.to_json()).headline == "Party A came first"
    return found


def test_re_marking_and_back_dating(owner: Party) -> None:
    """He marks the stolen model and writes an early date: both marks hold in his model, one in his original."""
    thief = mark(owner.model, 666, said="2020-01-01")
    found = lost(owner, thief, "copying", "re-marking", "overwriting", "back-dating")
    looks = {(one.mark_of, one.place, one.kind): one for one in found.looks}
    assert looks["b", "b", "published"].marked
    assert looks["a", "b", "original"].claim.z > 50
    assert abs(looks["b", "a", "original"].claim.z) < 6
    assert found.dates["b"].self_declared == "2020-01-01"
    assert "No third party attests it" in " ".join(dispute_words(found.to_json()).reasons)
    turned = settle(thief, owner)
    assert turned.first == "b", "whichever side he comes from"
    assert turned.seen == tuple((deed, "a") for deed, _ in found.seen)


def test_an_attested_date_does_not_help_the_thief(owner: Party) -> None:
    """He had his record stamped before the owner did: his original carries the owner's mark all the same."""
    thief = mark(owner.model, 666, attested="2026-01-01T00:00:00+00:00")
    found = lost(owner, thief, "copying", "re-marking", "overwriting")
    assert found.registered_first == "b"
    assert "was made after this watermark" in dispute_words(found.to_json()).reasons[-1]


def test_overwriting(owner: Party) -> None:
    """He roughens the model, calls that his original, and lays a louder mark over it."""
    rng = np.random.default_rng(3)
    rough = owner.model.with_dc(owner.model.sh[:, 0] + 0.03 * rng.normal(size=(len(owner.model), 3)))
    lost(owner, mark(rough, 666, psnr_db=38.0), "re-marking", "overwriting")


def test_inversion(owner: Party) -> None:
    """He subtracts a mark of his own from the stolen model, calls the rest his original, and claims what he stole."""
    layout = owner.opened.layout
    chips = signs(THIEF.derive(CHIPS, b"forged"), layout.chips)
    own = layout.displace(owner.opened.strength * layout.amplitudes * chips)
    forged = mark(owner.model.with_(sh=add_dc(owner.model.sh, -own)), 666)
    lost(owner, Party(forged.opened, owner.model), "inversion")


def test_copying(owner: Party) -> None:
    """He takes the model as it is, and registers it as his own."""
    record = mark(owner.model, 666).opened
    lost(owner, Party(record, owner.model), "copying")


def test_two_who_marked_one_unmarked_model(owner: Party, small_plant: GaussianModel) -> None:
    other = mark(small_plant, 2, said="2019-01-01", attested="2026-02-01T00:00:00+00:00")
    found = settle(owner, other)
    assert (found.first, found.same_original, found.registered_first) == ("neither", True, "b")
    assert found.seen == (("same original", ""),)
    words = dispute_words(found.to_json())
    assert words.headline.startswith("Inconclusive")
    assert "By the attested times, Party B registered first." in words.reasons
    undated = settle(owner, Party(replace(other.opened, attested=None), other.model))
    assert undated.registered_first == ""
    assert "The dates do not tell" in " ".join(dispute_words(undated.to_json()).reasons)


def test_an_original_that_equals_the_owners_to_rounding_is_named(owner: Party, small_plant: GaussianModel) -> None:
    """What several copies give away, or a file that leaked: it decides nothing, and is said."""
    rng = np.random.default_rng(5)
    near = small_plant.with_dc(small_plant.sh[:, 0] + 1e-4 * rng.normal(size=(len(small_plant), 3)))
    found = settle(owner, mark(near, 2))
    assert found.first == "neither"
    assert found.seen == (("equal originals", ""),)
    assert "equal to rounding" in " ".join(dispute_words(found.to_json()).reasons)


def test_a_published_model_with_neither_mark_is_named(owner: Party, small_plant: GaussianModel) -> None:
    other = mark(small_plant, 2)
    found = settle(owner, Party(other.opened, small_plant))
    assert ("unmarked", "b") in found.seen
    assert "Neither watermark was found in the model that Party B published" in " ".join(
        dispute_words(found.to_json()).reasons
    )


@pytest.mark.long
def test_two_who_have_nothing_in_common(owner: Party, small_plant: GaussianModel) -> None:
    rng = np.random.default_rng(8)
    foreign = small_plant.with_(
        means=rng.uniform(-1, 1, small_plant.means.shape),
        log_scales=rng.uniform(-5, -3, small_plant.means.shape),
        opacity_logits=rng.standard_normal(len(small_plant)),
    )
    found = settle(owner, mark(foreign.take(np.arange(len(foreign) // 2)), 2, psnr_db=40.0))
    assert (found.first, found.same_original, found.seen) == ("neither", False, ())


def test_both_marks_in_both_originals_decide_nothing(owner: Party, small_plant: GaussianModel) -> None:
    other = mark(small_plant, 2)
    swapped = (
        Party(replace(mine.opened, reference=theirs.model, header=named), mine.model)
        for mine, theirs, named in (
            (owner, other, replace(owner.opened.header, reference_digest="a" * 64)),
            (other, owner, replace(other.opened.header, reference_digest="b" * 64)),
        )
    )
    found = settle(*swapped)
    assert (found.first, found.seen) == ("both", ())
    assert "both originals are marked" in dispute_words(found.to_json()).finding


def test_every_mark_must_meet_the_strict_rate(owner: Party) -> None:
    thief = mark(owner.model, 666)
    for party in (owner, thief):
        assert party.opened.attested is None or not party.opened.attested.drawn
    drawn = Party(replace(owner.opened, attested=Attested("2026-03-01", "x", drawn=True)), owner.model)
    found = settle(drawn, thief)
    assert {one.claim.false_claim_rate for one in found.looks} == {DISHONEST_CLAIMANT_RATE}


def test_the_page_stands_alone_and_names_stay_text(owner: Party) -> None:
    said = replace(owner.opened.header, registered_at="<script>alert(1)</script>")
    found = settle(Party(replace(owner.opened, header=said), owner.model), mark(owner.model, 666)).to_json()
    page = dispute_page(found)
    assert "<script" not in page
    assert not re.search(r"<link|@import|url\(|src=|\bon\w+=", page)
    for part in ("Party A came first", "Re-marking", "(self-declared)", owner.opened.header.record_id):
        assert part in page
    for words in (dispute_words(found), dispute_words(found, PLAIN)):
        assert len(words.looks) == 6
