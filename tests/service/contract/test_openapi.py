"""The API's description is frozen: a change of the API is a change of openapi/openapi.json, seen in review."""

from __future__ import annotations

import json
from pathlib import Path

from engine.cli.app import run

FROZEN = Path(__file__).parents[3] / "openapi" / "openapi.json"


def test_frozen(tmp_path: Path) -> None:
    import service.cli.app  # noqa: F401  adds the service's commands

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
