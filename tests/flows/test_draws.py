"""What a time-stamping service draws for a plan: nobody chooses it, all copies share it, and it is checked offline."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError, MalformedRecordError
from engine.flows.embed import copy_mark as marking
from engine.flows.embed.draws import Draws
from engine.flows.embed.embedding import Embedding, embed
from engine.flows.embed.layer_strengths import Fidelity
from engine.flows.embed.profiles import compose, profile
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.draw import DRAWN, STAMPS, draw_request, stamps_in, terms_of
from engine.flows.records.opened_record import open_attested, open_record
from engine.flows.verify.search import VerifyConfig, verify_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import GaussianModel
from engine.records.attestation import Trust
from engine.records.record import Record
from engine.records.timestamps import drawn_from, make_query, stamped_at
from engine.usecases.mark import settings_note
from engine.watermark.rates import DRAWS, applicable_rate
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE
from tests.records.test_timestamps import Authority

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the time stamps"),
]

KEY = bench_key(1)
SMALL = profile("fast", landmark_views=0, views=2, view_size=192)


@dataclass
class Drawer:
    """A time-stamping service that counts its requests."""

    authority: Authority
    requests: list[bytes] = field(default_factory=list)

    def __call__(self, request: bytes) -> bytes:
        self.requests.append(request)
        return self.authority.reply(make_query(request))

    @property
    def trust(self) -> Trust:
        return Trust(self.authority.roots)


@pytest.fixture(scope="module")
def drawer(tmp_path_factory: pytest.TempPathFactory) -> Drawer:
    return Drawer(Authority(tmp_path_factory.mktemp("authority")))


def made(model: GaussianModel, copy: str = "a", **options: object) -> Embedding:
    return embed(model, KEY, original_sha256="11" * 32, config=SMALL, copy=copy, **{"bits": 16, **options})


@pytest.fixture(scope="module")
def first(small_plant: GaussianModel, drawer: Drawer) -> Embedding:
    return made(small_plant, stamp=drawer)


def altered(record: Record, **changes: object) -> bytes:
    """The record with other members, sealed by its owner, who has the key."""
    plan = {**record.plan, **changes.pop("plan", {})}
    fresh = Record.make(
        KEY,
        record.reference_arrays,
        original_digest=record.header.original_digest,
        plan=(plan, record.plan_arrays),
        extra={**record.extra, **changes},
        copy=record.copy,
    )
    return fresh.to_bytes(KEY)


def basis(data: bytes, trust: Trust) -> tuple[str, float, tuple[str, ...]]:
    opened, notes = open_attested(data, KEY, trust)
    rate = applicable_rate(0.1, opened.attested)
    return rate.basis, rate.rate, notes


def test_a_record_drawn_for_claims_at_chance_rate_and_counts_the_requests(
    small_plant: GaussianModel, first: Embedding, drawer: Drawer
) -> None:
    data = first.record.to_bytes(KEY)
    opened, notes = open_attested(data, KEY, drawer.trust)
    assert notes == ()
    assert opened.attested is not None
    assert opened.attested.drawn
    assert "Test stamps" in opened.attested.by
    claim = verify_model(first.model, opened, VerifyConfig(route="model")).claim
    plain = verify_model(first.model, open_record(data, KEY), VerifyConfig(route="model")).claim
    assert (claim.rate_basis, claim.false_claim_rate) == ("drawn", CHANCE_RATE)
    assert (plain.rate_basis, plain.false_claim_rate) == ("self_declared", DISHONEST_CLAIMANT_RATE)
    assert claim.tries == DRAWS * plain.tries
    assert claim.z == plain.z
    assert claim.verdict.value == plain.verdict.value == "marked"


def test_nobody_is_believed_who_is_not_vouched_for(first: Embedding, tmp_path: Path) -> None:
    data = first.record.to_bytes(KEY)
    for trust, said in ((Trust(), "no certificate"), (Trust(Authority(tmp_path).roots), "does not hold")):
        found, rate, (note,) = basis(data, trust)
        assert (found, rate) == ("self_declared", DISHONEST_CLAIMANT_RATE)
        assert said in note


def test_what_is_drawn_follows_from_the_stamp_and_decides_the_chips(first: Embedding, drawer: Drawer) -> None:
    """A commitment of one's own choice is no draw, though a true stamp of the same terms lies beside it."""
    opened = open_record(first.record.to_bytes(KEY), KEY)
    own = altered(first.record, plan={"commitments": {DRAWN: "ab" * 32}})
    assert not np.array_equal(open_record(own, KEY).spreading.chips, opened.spreading.chips)
    found, _, (note,) = basis(own, drawer.trust)
    assert found == "self_declared"
    assert "something else" in note


@pytest.mark.parametrize("what", ["amplitudes", "message", "copies"])
def test_a_plan_settled_after_the_stamp_is_not_what_was_stamped(first: Embedding, drawer: Drawer, what: str) -> None:
    """One request, very many plans: each would have other chips, so the stamp is about all of the plan."""
    record = first.record
    arrays = dict(record.plan_arrays)
    plan = dict(record.plan)
    if what == "amplitudes":
        arrays["amplitudes"] = np.asarray(arrays["amplitudes"] * np.float32(1.001))
    elif what == "message":
        plan["message"] = "0123" if plan["message"] != "0123" else "3210"
    else:
        arrays["copies/amplitudes"] = np.asarray(arrays["copies/amplitudes"] * np.float32(1.001))
    other = Record.make(
        KEY, record.reference_arrays, original_digest="11" * 32, plan=(plan, arrays), extra=record.extra, copy="a"
    )
    found, _, (note,) = basis(other.to_bytes(KEY), drawer.trust)
    assert found == "self_declared"
    assert "of something else" in note


def test_another_key_or_original_is_another_request(first: Embedding) -> None:
    record = first.record
    digest, plan = bytes.fromhex(record.header.reference_digest), (record.plan, record.plan_arrays)
    terms = terms_of(KEY, digest, plan)
    asked = draw_request(bytes.fromhex("11" * 32), terms)
    stamped_at(stamps_in(record)[-1], asked)  # is about this
    others = {
        draw_request(bytes.fromhex("12" * 32), terms),
        draw_request(bytes.fromhex("11" * 32), terms_of(bench_key(2), digest, plan)),
        draw_request(bytes.fromhex("11" * 32), terms_of(KEY, bytes(32), plan)),
    }
    assert len(others | {asked}) == 4


def test_copies_share_what_was_drawn_once(small_plant: GaussianModel, first: Embedding, drawer: Drawer) -> None:
    before = len(drawer.requests)
    again = made(small_plant, "b", stamp=drawer, earlier=first.record)
    assert len(drawer.requests) == before, "asked anew"
    one, other = (open_record(each.record.to_bytes(KEY), KEY) for each in (first, again))
    np.testing.assert_array_equal(one.spreading.chips, other.spreading.chips)
    assert one.grain_key == other.grain_key
    assert basis(again.record.to_bytes(KEY), drawer.trust)[0] == "drawn"
    lone = made(small_plant, "c", earlier=first.record)  # who cannot ask goes by the record
    assert lone.record.plan["commitments"] == first.record.plan["commitments"]
    with pytest.raises(InputError, match="marked before"):
        embed(
            small_plant,
            KEY,
            original_sha256="11" * 32,
            config=SMALL,
            copy="d",
            bits=24,
            stamp=drawer,
            earlier=first.record,
        )


def test_copies_have_the_settings_of_the_first_where_none_are_named(
    small_plant: GaussianModel, first: Embedding, drawer: Drawer
) -> None:
    """Else `auto`, or the default of another version, would refuse copies of what was marked before."""
    about = {"original_sha256": "11" * 32, "copy": "d", "bits": 16, "stamp": drawer, "earlier": first.record}
    again = embed(small_plant, KEY, config=compose("auto"), **about)
    assert again.record.extra["settings"] == first.record.extra["settings"]
    np.testing.assert_array_equal(again.record.plan_arrays["amplitudes"], first.record.plan_arrays["amplitudes"])
    terms = MarkTerms(config=compose("auto"), earlier=first.record)
    assert settings_note(terms, again)
    assert not settings_note(replace(terms, config=profile("fast")), again)
    chosen = replace(again, report=replace(again.report, choice=object()))
    assert not settings_note(terms, chosen), "of another original: nothing was shared"
    with pytest.raises(InputError, match="marked before"):
        embed(small_plant, KEY, config=compose("auto", psnr_db=44.0), **about)


@pytest.mark.parametrize("drawn", ["", "cd" * 32])
def test_copies_of_what_nobody_or_a_service_by_itself_drew_for_stay_so(
    small_plant: GaussianModel, drawer: Drawer, drawn: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second owner's layer would give both away; and such records claim at 2^-128."""
    with monkeypatch.context() as before:
        before.setattr(Draws, "draw", lambda *_: (drawn, None))
        plain = made(small_plant, "a").record
    assert plain.plan.get("commitments") == ({DRAWN: drawn} if drawn else None)
    asked = len(drawer.requests)
    later = made(small_plant, "b", stamp=drawer, earlier=plain).record
    assert len(drawer.requests) == asked
    chips = [open_record(each.to_bytes(KEY), KEY).spreading.chips for each in (plain, later)]
    np.testing.assert_array_equal(*chips)
    opened = open_record(plain.to_bytes(KEY), KEY)
    assert opened.draw is None
    assert basis(plain.to_bytes(KEY), drawer.trust)[:2] == ("self_declared", DISHONEST_CLAIMANT_RATE)


def test_every_plan_that_is_tried_is_a_request_of_its_own(
    small_plant: GaussianModel, drawer: Drawer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A weaker plan, made because the chips were too visible, needs a time stamp of its own."""
    before, looks = len(drawer.requests), iter([Fidelity(30.0, 0.5)])
    measure: Callable[..., Fidelity] = marking.measure
    monkeypatch.setattr(marking, "measure", lambda *given: next(looks, None) or measure(*given))
    twice = made(small_plant, stamp=drawer)
    assert len(set(drawer.requests[before:])) == 2
    stamps = stamps_in(twice.record)
    assert len(stamps) == 2
    assert twice.record.plan["commitments"][DRAWN] == drawn_from(stamps[-1])
    assert basis(twice.record.to_bytes(KEY), drawer.trust)[0] == "drawn"
    monkeypatch.setattr(marking, "measure", measure)
    looks = iter([Fidelity(30.0, 0.5)])
    monkeypatch.setattr(marking, "measure", lambda *given: next(looks, None) or measure(*given))
    copy = made(small_plant, "b", earlier=twice.record)
    assert stamps_in(copy.record) == stamps


def test_stamps_have_no_place_in_earlier_formats(first: Embedding) -> None:
    """The chips of those follow from the copy's name, which no stamp is about."""
    header = replace(first.record.header, format_version=2)
    plan = {name: value for name, value in first.record.plan.items() if name != "copies"}
    arrays = {n: a for n, a in first.record.plan_arrays.items() if not n.startswith("copies/") and n != "multiples"}
    fresh = Record.make(
        KEY, first.record.reference_arrays, original_digest="11" * 32, plan=(plan, arrays), extra=first.record.extra
    )
    older = replace(fresh, header=replace(fresh.header, format_version=header.format_version))
    with pytest.raises(MalformedRecordError, match="format 2"):
        open_record(older.to_bytes(KEY), KEY)
    for odd in ([], ["!"], "x", [1]):
        with pytest.raises(MalformedRecordError):
            open_record(altered(first.record, **{STAMPS: odd}), KEY)
