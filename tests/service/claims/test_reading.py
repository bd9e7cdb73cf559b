"""The answer of a verification: one object, alike in the job's result, with the claim, in the client and on the
command line."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any, get_type_hints

import pytest
from pydantic import TypeAdapter

from engine.present.reading import Reading, reading_of
from service.claims.document import of_what_was_found, summary_of
from service.claims.issuing import issue
from service.claims.report import report_html
from service.client.answers import Job as ClientJob
from service.client.answers import Reading as ClientReading
from service.client.answers import Verified, verified
from service.core import Service
from service.http import results
from service.jobs.port import Job, State
from service.problems import Problem
from service.settings import Settings
from service.verifications.flow import count_asset
from tests.service.claims.cases import KINDS, PICTURES, nothing, reply
from tests.service.claims.conftest import Registry
from tests.service.claims.test_searched import unrelated

MEMBERS = {each.name for each in fields(Reading)}


@pytest.fixture
def answer(registry: Registry, tmp_path: Any) -> Any:
    """The result of a job that came to a reply."""
    service, issued = Service.open(Settings(data_dir=tmp_path)), list[str]()

    def of(found: dict[str, Any]) -> dict[str, Any]:
        job = Job(f"job_{len(issued)}", "acme", "key", "verify", State.RUNNING, {"model": "12" * 32, "images": []})
        found = {"tried": [], "kept": {}, **found, "searched": {"scope": "one", "assets": 1}}
        result = dict(issue(service, job, of_what_was_found(found)))
        issued.append(result["claim_id"])
        strict = TypeAdapter(results.VerifyResult).validate_python(result)
        assert strict == result, "members that the API's description does not have"
        return result

    yield of
    service.close()


def in_client(result: dict[str, Any]) -> Verified:
    plain = dict.fromkeys(field.name for field in fields(ClientJob)) | {"kind": "verify", "state": "succeeded"}
    return verified(ClientJob(**plain | {"result": result}))  # type: ignore[arg-type]


def test_all_doors_have_the_same_members() -> None:
    assert set(get_type_hints(results.Reading)) == MEMBERS == {each.name for each in fields(ClientReading)}
    shown = {each.name for each in fields(Verified)}
    assert set(get_type_hints(results.VerifyResult)) == shown
    assert set(get_type_hints(results.AssetReading)) == MEMBERS | {"asset_id", "copy_name"}


@pytest.mark.parametrize("kind", KINDS)
def test_result_claim_client_and_command_line_say_the_same(registry: Registry, answer: Any, kind: str) -> None:
    found = reply(kind)
    result = answer(found)
    here = reading_of(found["claim"], found["registered_message"]).to_json()  # what `verify --json` prints
    assert {name: result[name] for name in MEMBERS} == here
    assert summary_of(registry.issue(found, "job_2").document).reading == here
    client = asdict(in_client(result))
    assert {name: client[name] for name in MEMBERS} == here


def test_bits_are_read_from_a_marked_suspect(answer: Any) -> None:
    found = reply("marked")
    result = answer(found)
    assert result["bits"]["hex"] == found["registered_message"] == result["registered_bits"]["hex"]
    assert int(result["bits"]["string"], 2) == int(found["registered_message"], 16)
    assert (result["matching"], result["bit_accuracy"], len(result["reliability"])) == (32, 1.0, 32)
    assert result["strength"] > 1000
    assert result["links"]["pack"] == f"{result['links']['claim']}/pack"
    assert in_client(result).bits.string == result["bits"]["string"]  # type: ignore[union-attr]


def test_nothing_is_said_of_bits_that_were_not_read(registry: Registry, answer: Any) -> None:
    result = answer(unrelated())
    assert (result["headline"], result["bits"], result["matching"], result["reliability"]) == (
        "Not recognized",
        None,
        None,
        None,
    )
    assert "recognized" in result["no_bits"]
    assert (
        "could be compared"
        in answer(nothing() | {"tried": [{"asset": "as_1", "verdict": "could_not_check"}]})["no_bits"]
    )
    claim = registry.issue(of_what_was_found(unrelated(searched={"scope": "one", "assets": 1})), "job_2")
    page = report_html(claim.document, claim.jws, PICTURES)
    assert "Message bits" not in page
    assert result["no_bits"] in page


def test_the_unmarked_original_is_called_that_and_nothing_is_to_be_taken_down(registry: Registry, answer: Any) -> None:
    result = answer(reply("not_marked"))
    assert result["headline"] == "Your unmarked original"
    assert "pack" not in result["links"]
    claim = registry.issue(reply("not_marked"), "job_2")
    assert "Your unmarked original" in report_html(claim.document, claim.jws, PICTURES)


def test_other_assets_have_an_entry_each(registry: Registry, answer: Any) -> None:
    registry.register(id="as_2", job="job_of_2", copy="Atelier Sued", message="8be81eaf", record_id="ee" * 16)
    registry.register(id="as_3", job="job_of_3", tenant="stranger")
    second = reply("inconclusive")["claim"]
    beside = [{"asset": name, "claim": second} for name in ("as_2", "as_gone", "as_3")]
    (other,) = answer(reply("marked") | {"others": beside})["others"]
    assert (other["asset_id"], other["copy_name"], other["verdict"]) == ("as_2", "Atelier Sued", "inconclusive")
    assert other["registered_bits"]["hex"] == "8be81eaf"
    assert {*other} == MEMBERS | {"asset_id", "copy_name"}


def test_copies_of_one_original_share_a_budget(registry: Registry, tmp_path: Any) -> None:
    registry.register(id="as_2", job="job_of_2")
    service = Service.open(Settings(data_dir=tmp_path, subject_verifies_per_day=2))
    for asset in ("as_1", "as_2"):
        count_asset(service, "acme", asset)
    with pytest.raises(Problem, match="at most 2 in 24 h"):
        count_asset(service, "acme", "as_2")
    service.close()
