"""GET /v1/me: the API key of a request, its scopes, and the use of its tenant's limits."""

import sqlalchemy as sa
from fastapi import APIRouter
from pydantic import BaseModel, Field

from service.db.schema import api_keys
from service.http.access import Anyone, Core
from service.http.error_responses import responses
from service.trust.api_keys import SCOPES, display_name
from service.uploads.store import stored_bytes, under_way

router = APIRouter(prefix="/v1/me", tags=["keys"])


class Self(BaseModel):
    """The API key of this request."""

    id: str
    label: str
    scopes: list[str]
    prefix: str = Field(description="How the key begins; the rest is a secret.")


class Used(BaseModel):
    """A limit of the tenant, and how much of it is used."""

    used: int
    most: int


class Limits(BaseModel):
    """Limits of the tenant; hourly limits are counted per key and reported when they are reached (429)."""

    queued_jobs: Used = Field(description="Jobs that are waiting or running.")
    open_uploads: Used = Field(description="Unfinished uploads.")
    stored_bytes: Used = Field(description="Uploads and assets, together.")


class Me(BaseModel):
    """The API key of the request."""

    tenant: str
    name: str = Field(description="Display name of the tenant; its id if none was entered.")
    key: Self
    limits: Limits


@router.get("", operation_id="me", responses=responses("unauthorized", "forbidden"))
def me(core: Core, caller: Anyone) -> Me:
    """The API key of this request, its tenant, and the tenant's limits. Any key may call this, whatever its scopes."""
    settings, tenant = core.settings, caller.tenant
    with core.db.read() as connection:
        name = display_name(connection, tenant)
        label = connection.execute(sa.select(api_keys.c.label).where(api_keys.c.id == caller.key_id)).scalar_one()
        opened, stored = under_way(connection, tenant), stored_bytes(connection, tenant)
    scopes = [scope for scope in SCOPES if scope in caller.scopes]
    limits = Limits(
        queued_jobs=Used(used=core.jobs.waiting(tenant), most=settings.queued_jobs),
        open_uploads=Used(used=opened, most=settings.open_uploads),
        stored_bytes=Used(used=stored, most=settings.tenant_bytes),
    )
    key = Self(id=caller.key_id, label=label, scopes=scopes, prefix=f"mk_{caller.key_id}")
    return Me(tenant=tenant, name=name, key=key, limits=limits)
