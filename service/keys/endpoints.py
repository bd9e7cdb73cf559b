"""/v1/keys: owner keys, sealed; shown once, if requested on creation."""

from typing import Annotated

import sqlalchemy as sa
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from engine.watermark.keys import OwnerKey
from service.db import schema
from service.db.schema import assets
from service.http.access import Admin, After, Core, Limit, Listed, Reader
from service.http.error_responses import OF_LIST, responses
from service.http.forms import RequestBody
from service.http.results import Time
from service.problems import Problem
from service.trust import owner_keys

router = APIRouter(prefix="/v1/keys", tags=["keys"])


_ONE_BYTE: JsonValue = {"type": "string", "pattern": r"^(..)\1+$"}
"""One byte repeated is no key."""
_EXAMPLE: JsonValue = {"label": "Studio", "reveal": True}


class NewKey(RequestBody):
    """An owner key to make, or to import."""

    model_config = ConfigDict(strict=True, json_schema_extra={"examples": [_EXAMPLE]})
    label: str = Field("", max_length=200, description="For display.")
    key: str | None = Field(
        None,
        pattern="^([0-9a-fA-F]{2}){32,1024}$",
        json_schema_extra={"not": _ONE_BYTE},
        description="To import: 64 or more hex digits, the last line of a key file; left out: a new key is made.",
    )
    reveal: bool = Field(False, description="Show the key in this answer, once, so that you can keep a copy.")


class KeyView(BaseModel):
    """An owner key; never its secret."""

    model_config = ConfigDict(from_attributes=True)
    id: str
    fingerprint: str = Field(description="Public short name of the key; records name it.")
    label: str
    created_at: Time


class MadeKey(KeyView):
    """A key just made or imported."""

    key: str | None = Field(description="Text of the key file, if requested. It is never shown again.")


class KeyList(Listed[KeyView]):
    """A page of keys, newest first."""


@router.post(
    "",
    status_code=201,
    operation_id="createKey",
    responses=responses("malformed-request", "unauthorized", "forbidden", "conflict", "invalid-request", "too-large"),
)
def create_key(body: NewKey, core: Core, caller: Admin, response: Response) -> MadeKey:
    """Make or import an owner key. It is sealed under the service's master key."""
    key = OwnerKey.generate() if body.key is None else owner_keys.parse_key(body.key)
    made = owner_keys.store(core.db, core.master, caller.tenant, key, body.label)
    response.headers["Cache-Control"] = "no-store"
    return MadeKey.model_validate(made._asdict() | {"key": key.to_text() if body.reveal else None})


@router.get("", operation_id="listKeys", responses=OF_LIST)
def list_keys(core: Core, caller: Reader, limit: Limit = 20, after: After = "") -> KeyList:
    """Owner keys of this tenant, newest first."""
    present = schema.owner_keys.c.deleted_at.is_(None)
    return KeyList.of(core, schema.owner_keys, caller.tenant, limit, after, where=present)


@router.delete(
    "/{key_id}",
    status_code=204,
    operation_id="deleteKey",
    responses=responses("unauthorized", "forbidden", "not-found", "conflict", "invalid-request"),
)
def delete_key(
    key_id: str,
    core: Core,
    caller: Admin,
    force: Annotated[bool, Query(description="Erase it even though assets are registered under it.")] = False,
) -> None:
    """Erase an owner key. What was marked with it can be checked again only once the key is imported again."""
    mine = (assets.c.tenant == caller.tenant) & (assets.c.owner_key == key_id)
    count = core.db.query(sa.select(sa.func.count()).select_from(assets).where(mine)).scalar_one()
    if count and not force:
        raise Problem("conflict", f"{count} assets are registered under this key; without it they cannot be checked")
    owner_keys.delete(core.db, caller.tenant, key_id)
