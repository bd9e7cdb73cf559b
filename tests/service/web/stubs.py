"""Answers of the API in its place: long lists, rare states, and what hostile names would do."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from pydantic import BaseModel

from service.assets.endpoints import Asset
from service.claims.endpoints import ClaimSummary
from service.http.job_responses import JobView

if TYPE_CHECKING:
    from playwright.sync_api import Page, Route

DAY = "2026-11-20T0{hour}:{minute:02}:00.000000+00:00"


def lists(page: Page, **items: list[dict[str, Any]]) -> list[dict[str, list[str]]]:
    """Serve these as the lists of /v1, newest first: by page, `state`, `verdict` and `q`. Returns the requests."""
    calls: list[dict[str, list[str]]] = []

    def answer(route: Route) -> None:
        where = urlsplit(route.request.url)
        query = parse_qs(where.query)
        calls.append({"path": [where.path], **query})
        found = [item for item in items[where.path.removeprefix("/v1/")] if _wanted(item, query)]
        after, limit = query.get("after", [""])[0], int(query.get("limit", ["20"])[0])
        first = next((k + 1 for k, item in enumerate(found) if item["id"] == after), 0)
        shown = found[first : first + limit]
        following = shown[-1]["id"] if first + limit < len(found) else None
        route.fulfill(json={"items": shown, "next": following})

    for name in items:
        page.route(lambda url, path=f"/v1/{name}": urlsplit(url).path == path, answer)  # type: ignore[misc]
    return calls


def _wanted(item: dict[str, Any], query: dict[str, list[str]]) -> bool:
    text = query.get("q", [""])[0].lower()
    return (
        item.get("state") in query.get("state", [item.get("state")])
        and item.get("verdict") in query.get("verdict", [item.get("verdict")])
        and text in json.dumps(item, ensure_ascii=False).lower()
    )


def at(number: int) -> str:
    """A time, the later the greater the number."""
    return DAY.format(hour=number // 60, minute=number % 60)


def a_job(number: int, **fields: Any) -> dict[str, Any]:
    """A job as the API shows it; queued if nothing else is said."""
    plain = dict.fromkeys(("result", "problem", "started_at", "finished_at", "position"))
    plain |= {"id": f"job_{number:024x}", "kind": "embed", "state": "queued", "stage": "", "fraction": 0.0, "name": ""}
    plain |= {"cancelling": False, "copy_name": "", "created_at": at(number), **fields}
    if plain["state"] != "queued":
        plain["started_at"] = at(number)
    if plain["state"] not in ("queued", "running"):
        plain["finished_at"] = at(number + 1)
    return _known(plain, JobView)


def an_asset(number: int, **fields: Any) -> dict[str, Any]:
    """An asset as a list shows it."""
    plain = {"id": f"as_{number:024x}", "label": f"Model {number}", "copy_name": "", "gaussians": 1000 + number}
    return _known(plain | {"registered_at": at(number), "record_id": f"{number:032x}", **fields}, Asset)


def a_claim(number: int, **fields: Any) -> dict[str, Any]:
    """A claim as a list shows it."""
    plain = {"id": f"cl_{number:024x}", "asset_id": None, "verdict": "inconclusive", "headline": "Not recognized"}
    plain |= {"finding": f"Nothing was recognised in suspect {number}.", "created_at": at(number), **fields}
    return _known(plain, ClaimSummary)


def _known(plain: dict[str, Any], shown_as: type[BaseModel]) -> dict[str, Any]:
    """The page must not live on what no service says."""
    assert plain.keys() <= shown_as.model_fields.keys(), plain.keys() - shown_as.model_fields.keys()
    return plain
