"""The API's description is frozen: a change of the API is a change of openapi/openapi.json, seen in review."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

from engine.cli.app import run
from engine.flows.embed.auto_profile import ChoiceReport
from engine.flows.embed.embedding import EmbedReport
from service.claims.schema import ClaimDocument

ROOT = Path(__file__).parents[3]
FROZEN = ROOT / "openapi" / "openapi.json"
SCRIPTS = ROOT / "service" / "web" / "js"


def test_frozen(tmp_path: Path) -> None:
    assert run(["openapi", "--out", str(tmp_path / "now.json")]) == 0
    now, frozen = (json.loads(path.read_text()) for path in (tmp_path / "now.json", FROZEN))
    assert now == frozen, "run 'mark3dgs openapi --out openapi/openapi.json' and look at the difference"


def test_operations_have_names_texts_and_problems() -> None:
    document = json.loads(FROZEN.read_text())
    names = set()
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            where = f"{method.upper()} {path}"
            assert operation["operationId"] not in names, where
            names.add(operation["operationId"])
            assert operation.get("description"), where
            statuses = set(operation["responses"])
            assert {"500", "503"} <= statuses, where
            if operation.get("security"):
                assert {"401", "403"} <= statuses, where


def named(schema: Any) -> set[str]:
    """Fields, parameters and words of enumerations anywhere in a schema."""
    if isinstance(schema, list):
        return set().union(*map(named, schema))
    if not isinstance(schema, dict):
        return set()
    own = {*schema.get("properties", {}), *map(str, schema.get("enum", ()))}
    own |= {schema["name"]} if isinstance(schema.get("name"), str) else set()
    return own.union(*map(named, schema.values()))


def test_the_page_speaks_of_nothing_that_the_api_does_not_have() -> None:
    """What it asks for by a wrong name is silently missing. Names with an underscore are the API's alone there."""
    known = named(json.loads(FROZEN.read_text())) | named(ClaimDocument.model_json_schema())
    # An asset's report has no schema.
    known |= {field.name for report in (EmbedReport, ChoiceReport) for field in fields(report)}
    said = {}
    for path in SCRIPTS.glob("*.js"):
        for name in re.findall(r"\b[a-z]+(?:_[a-z0-9]+)+\b", path.read_text()):
            said[name] = path.name
    assert len(said) > 30
    assert {name: said[name] for name in said.keys() - known - {"end_header"}} == {}
