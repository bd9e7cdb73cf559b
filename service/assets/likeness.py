"""Which manifests belong to something like an uploaded model or picture: stripped credentials are found again.

No owner key, record or mark is used. The index compares with sketches of published models, which can be computed from
such a model alone; only assets whose owner set `by_content` are searched.
"""

import asyncio
import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from service.asset_screening import scores
from service.assets.conversions import once
from service.core import Service
from service.db.schema import assets, manifests, published
from service.http.budgets import spend
from service.jobs.port import Job, Run, State
from service.problems import Problem
from service.processes import Reply, run_once, task_folder
from service.trust.api_keys import Caller
from service.uploads.store import kind_of

SEARCH_SECONDS, INDEX_SECONDS = 60.0, 600.0
"""An index that lacks many assets is made first, which a search that gave up will find made."""


async def find_alike(service: Service, caller: Caller, path: Path) -> list[tuple[str, int]]:
    """Ids of manifests, each with its score (50 or 100), the highest first; of equal ones those of the asset that was
    registered first, which later lookalikes cannot displace; of one asset the newest first.

    unreadable-model or unreadable-image where it is neither; unsupported-media-type for cameras; budget-exceeded where
    too many of the tenant's questions are being answered, or were asked today about things like one asset.
    """
    joined = manifests.join(assets, manifests.c.asset == assets.c.id).join(published, published.c.asset == assets.c.id)
    query = sa.select(manifests.c.id, assets.c.original_sha256).select_from(joined).where(published.c.by_content)
    query = query.order_by(assets.c.registered_at, assets.c.id, manifests.c.created_at.desc(), manifests.c.id)
    rows = await asyncio.to_thread(lambda: service.db.query(query).all())
    this = (secrets.token_hex(16), "by content")  # a question of its own: two askers of one share no file
    found = json.loads(await once(service, caller.tenant, this, lambda: _search(service, caller, path, rows)))
    if found:
        await asyncio.to_thread(_count, service, caller, max(found, key=found.__getitem__))
    hits = [(row.id, int(found[row.original_sha256])) for row in rows if row.original_sha256 in found]
    return sorted(hits, key=lambda hit: -hit[1])


def _search(service: Service, caller: Caller, path: Path, rows: Any) -> str:
    """Scores by original, as JSON."""
    kind = kind_of(path, "")
    if kind == "cameras":
        raise Problem("unsupported-media-type", "the body is neither a model nor a picture")
    suspect = {"model": None, "images": [str(path)]} if kind == "picture" else {"model": str(path)}
    with task_folder(service.settings) as folder:

        def work(task: str, request: Mapping[str, Any]) -> Reply:
            seconds = INDEX_SECONDS if task == "index" else SEARCH_SECONDS
            reply = run_once(service.settings, task, request, folder, seconds, caller.tenant)
            if reply is None:
                text = f"the search took over {seconds:.0f} s"
                raise Problem("unavailable", text, headers={"Retry-After": "60"})
            return reply

        run = Run(Job("", caller.tenant, caller.key_id, "match", State.RUNNING, {}), folder=folder, work=work)
        return json.dumps(scores(service, run, suspect, rows))


def _count(service: Service, caller: Caller, original: str) -> None:
    """Against the asker's budget of this original: many answers about slight changes tell what the index sees."""
    limit = service.settings.subject_verifies_per_day
    subject = f"subject:{caller.tenant}:{original}"
    spend(service.db, subject, limit, 24, "questions about what derives from one original")
