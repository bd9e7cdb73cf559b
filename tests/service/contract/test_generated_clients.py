"""What generators of clients make of the API's description: nothing is lost, results have types, requests examples."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import jsonschema_rs
import pytest

from service.http.job_responses import view
from service.jobs.port import Job, State
from service.verifications.endpoints import VerifyRequest
from tests.service.contract.test_openapi import FROZEN

DOCUMENT = json.loads(FROZEN.read_text())
JSON = "application/json"


def schemas(node: Any, where: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Everything in the document that may be a schema, with its place."""
    if isinstance(node, dict):
        yield where, node
    for name, inner in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from schemas(inner, f"{where}/{name}")


def bodies() -> Iterator[tuple[str, dict[str, Any]]]:
    """Each JSON body's operation and schema."""
    for methods in DOCUMENT["paths"].values():
        for operation in methods.values():
            found = operation.get("requestBody", {}).get("content", {}).get(JSON)
            if found is not None:
                yield operation["operationId"], found["schema"]


def validator(schema: dict[str, Any]) -> Any:
    return jsonschema_rs.validator_for({**schema, "components": DOCUMENT["components"]})


def test_no_fields_stand_beside_a_combination() -> None:
    """Generators take the one or the other: `openapi-python-client` lost three fields of verify."""
    both = [
        where
        for where, schema in schemas(DOCUMENT)
        if "properties" in schema and {"oneOf", "anyOf", "allOf"} & set(schema)
    ]
    assert both == []


def test_the_ways_to_verify_have_all_fields_between_them() -> None:
    ways = dict(bodies())["verify"]["oneOf"]
    assert set().union(*(way["properties"] for way in ways)) == set(VerifyRequest.model_fields)
    assert [way["required"] for way in ways] == [["upload_id"], ["image_upload_ids"]]
    valid = validator(dict(bodies())["verify"]).is_valid
    assert valid({"upload_id": "up_1", "asset_id": "as_1", "route": "auto", "false_claim_rate": 1e-12})
    assert valid({"image_upload_ids": ["up_1"], "cameras_upload_id": "up_2"})
    for bad in ({}, {"upload_id": "up_1", "image_upload_ids": ["up_2"]}, {"image_upload_ids": []}, {"upload_id": None}):
        assert not valid(bad), bad


@pytest.mark.parametrize(("operation", "schema"), [pytest.param(*each, id=each[0]) for each in bodies()])
def test_every_body_has_examples_that_are_valid(operation: str, schema: dict[str, Any]) -> None:
    name = schema.get("$ref", "").rpartition("/")[2]
    whole = DOCUMENT["components"]["schemas"][name] if name else schema
    for way in whole.get("oneOf", [whole]):
        assert way["examples"], operation
        for example in way["examples"]:
            validator(schema).validate(example)


def test_results_and_files_have_types() -> None:
    known = DOCUMENT["components"]["schemas"]
    result = known["JobView"]["properties"]["result"]["anyOf"]
    named = {way["$ref"].rpartition("/")[2] for way in result if "$ref" in way}
    assert named == {"EmbedResult", "VerifyResult", "DisputeResult"}
    for name in ("EmbedResult", "VerifyResult"):
        for example in known[name]["examples"]:
            validator(known[name]).validate(example)
    info = known["Upload"]["properties"]["info"]["anyOf"]
    assert {"$ref": "#/components/schemas/FileInfo"} in info


def test_times_are_times_and_null_until_they_come() -> None:
    times = [
        (where, schema[name])
        for where, schema in schemas(DOCUMENT["components"]["schemas"])
        if where.endswith("/properties")
        for name in schema
        if name.endswith("_at")
    ]
    assert len(times) >= 7
    for where, schema in times:
        assert next(way.get("format") for way in schema.get("anyOf", [schema])) == "date-time", where
    waiting = view(Job("job_1", "t", "k", "embed", State.QUEUED, {}, created_at="2026-01-01T00:00:00+00:00"))
    assert (waiting.started_at, waiting.finished_at) == (None, None)


def test_what_an_earlier_version_answered_still_passes() -> None:
    """Nothing of a result is dropped, whatever is in it."""
    old = {"claim_id": "cl_1", "verdict": "marked", "another": [1]}
    output = view(Job("job_1", "t", "k", "verify", State.SUCCEEDED, {}, result=old, created_at="2026-01-01T00:00:00Z"))
    assert output.model_dump()["result"] == old
