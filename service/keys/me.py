"""/v1/me: the API key of a request, its scopes, its tenant's name and limits, and the address of the service."""

from typing import Annotated

import sqlalchemy as sa
from fastapi import APIRouter
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, HttpUrl, JsonValue

from service.claims.schema import Url
from service.core import Service
from service.db.schema import api_keys, tenants
from service.http.access import Admin, Anyone, Core
from service.http.error_responses import responses
from service.http.forms import RequestBody
from service.problems import Problem
from service.settings import OPTIONAL_ROUTERS
from service.trust.api_keys import FIRST_TENANT, MOST_CHARACTERS, OPERATOR, SCOPES, Caller, check_tenant, name_tenant
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


class About(BaseModel):
    """The service."""

    public_url: str = Field(description="Its address in claims and links; empty if none was entered.")
    may_set_public_url: bool = Field(description="Whether this key may enter it (`PATCH /v1/me`).")
    parts: list[str] = Field(description="The optional parts of the API that are there.")


class Me(BaseModel):
    """The API key of the request."""

    tenant: str
    name: str = Field(description="Display name of the tenant; its id if none was entered.")
    is_named: bool = Field(description="Whether a display name was entered.")
    key: Self
    limits: Limits
    service: About


def _bare(url: HttpUrl) -> HttpUrl:
    if url.query or url.fragment:
        raise ValueError("provide scheme, host and path alone")
    return url


_EXAMPLE: JsonValue = {"name": "Studio Acme, Hamburg", "public_url": "https://mark.acme.example"}


class Naming(RequestBody):
    """What to change; what is left out stays."""

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE]})
    name: str | None = Field(
        None, min_length=1, max_length=MOST_CHARACTERS, description="Display name of the tenant, in later claims."
    )
    public_url: Annotated[Url, AfterValidator(_bare)] | None = Field(
        None, description="Address of the service in later claims and links: scheme, host and path; null removes it."
    )


@router.get("", operation_id="me", responses=responses("unauthorized", "forbidden"))
def me(core: Core, caller: Anyone) -> Me:
    """The API key of this request, its tenant, and the tenant's limits. Any key may call this, whatever its scopes."""
    return _seen(core, caller)


@router.patch(
    "",
    operation_id="updateMe",
    responses=responses("malformed-request", "unauthorized", "forbidden", "conflict", "invalid-request", "too-large"),
)
def update_me(body: Naming, core: Core, caller: Admin) -> Me:
    """Enter the display name of this key's tenant, and the public address of the service, for later claims.

    The address is entered by keys of the first tenant and of scope `operator`, where MARK3DGS_PUBLIC_URL sets none.
    """
    addressed = "public_url" in body.model_fields_set
    if addressed and not _is_host(caller):
        raise Problem("forbidden", "the address of the service is entered by its first tenant or its operator")
    if body.name is not None:
        check_tenant(body.name)
    if addressed:
        core.set_public_url(caller, str(body.public_url or ""))
    if body.name is not None:
        name_tenant(core.db, caller.tenant, body.name)
    return _seen(core, caller)


def _is_host(caller: Caller) -> bool:
    return caller.tenant == FIRST_TENANT or caller.may(OPERATOR)


def _seen(core: Service, caller: Caller) -> Me:
    settings, tenant = core.settings, caller.tenant
    with core.db.read() as connection:
        name = connection.execute(sa.select(tenants.c.name).where(tenants.c.id == tenant)).scalar_one_or_none()
        label = connection.execute(sa.select(api_keys.c.label).where(api_keys.c.id == caller.key_id)).scalar_one()
        opened, stored = under_way(connection, tenant), stored_bytes(connection, tenant)
    scopes = [scope for scope in SCOPES if scope in caller.scopes]
    limits = Limits(
        queued_jobs=Used(used=core.jobs.waiting(tenant), most=settings.queued_jobs),
        open_uploads=Used(used=opened, most=settings.open_uploads),
        stored_bytes=Used(used=stored, most=settings.tenant_bytes),
    )
    key = Self(id=caller.key_id, label=label, scopes=scopes, prefix=f"mk_{caller.key_id}")
    about = About(
        public_url=core.public_url(),
        may_set_public_url=caller.may("admin") and _is_host(caller) and not settings.public_url,
        parts=[part for part in OPTIONAL_ROUTERS if settings.has_router(part)],
    )
    return Me(tenant=tenant, name=name or tenant, is_named=name is not None, key=key, limits=limits, service=about)
