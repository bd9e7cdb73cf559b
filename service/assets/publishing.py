"""/v1/assets/{id}/credentials: what an owner publishes of an asset. Nothing, until it is set."""

from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import APIRouter
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue

from engine.formats.gltf.metadata import MOST_CHARACTERS
from service.core import Service
from service.db import missing, own
from service.db.schema import assets, published
from service.http.access import Admin, Core, Reader
from service.http.error_responses import OF_OWN, responses
from service.http.forms import RequestBody
from service.trust import audit

router = APIRouter(prefix="/v1/assets", tags=["credentials"])
_EXAMPLE: JsonValue = {"by_content": True, "rights": "(c) 2026 Studio Acme, all rights reserved"}
_BY_CONTENT = "Whether anyone with an API key finds its manifests by something similar (`POST /v1/matches/byContent`)."
_RIGHTS = "Statement of rights in the .glb files that are signed from now on."


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("provide printable characters, in one line")
    return text


class Publication(RequestBody):
    """What to publish; what is left out is not."""

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE]})
    by_content: bool = Field(False, description=_BY_CONTENT, strict=True)
    rights: Annotated[str, AfterValidator(_printable)] = Field("", max_length=MOST_CHARACTERS, description=_RIGHTS)


NOTHING = Publication()


class Published(BaseModel):
    """What is published of an asset's credentials."""

    by_content: bool = Field(description=_BY_CONTENT)
    rights: str = Field(description=_RIGHTS)


@router.get("/{asset_id}/credentials", operation_id="getPublication", responses=OF_OWN)
def get_publication(asset_id: str, core: Core, caller: Reader) -> Published:
    """What is published of an asset's credentials."""
    own(core.db, assets, caller.tenant, asset_id)
    return published_of(core, asset_id)


@router.put(
    "/{asset_id}/credentials",
    operation_id="putPublication",
    responses={**OF_OWN, **responses("malformed-request", "too-large")},
)
def put_publication(asset_id: str, core: Core, caller: Admin, body: Publication = NOTHING) -> Published:
    """Set what is published of an asset's credentials: without a body, nothing. The log keeps who set what."""
    values: dict[str, Any] = body.model_dump()
    with core.db.exclusive() as connection:
        mine = (assets.c.id == asset_id) & (assets.c.tenant == caller.tenant)
        if connection.execute(sa.select(assets.c.id).where(mine)).first() is None:
            raise missing(assets, asset_id)
        connection.execute(sa.delete(published).where(published.c.asset == asset_id))
        connection.execute(published.insert().values(asset=asset_id, **values))
        audit.append(connection, caller.tenant, "asset.published", values, asset_id)
    return Published(**values)


def published_of(service: Service, asset: str) -> Published:
    """What an owner set, or nothing."""
    row = service.db.query(sa.select(published).where(published.c.asset == asset)).first()
    return Published.model_validate(NOTHING if row is None else row, from_attributes=True)
