"""/v1/assets: what was marked, and its files."""

import json
from typing import Annotated, Any, Literal

import sqlalchemy as sa
from fastapi import APIRouter, Header, Query, Response
from pydantic import BaseModel, Field

from service.assets.converting import convert
from service.core import Service
from service.db.schema import assets
from service.http.access import Core, Reader
from service.http.downloads import MODEL_TYPE, file_responses, send_blob
from service.http.failures import responses
from service.http.lists import After, Limit, page
from service.problems import Problem

router = APIRouter(prefix="/v1/assets", tags=["assets"])
RECORD_TYPE = "application/vnd.mark3dgs.record"
Range = Annotated[str | None, Header(description="bytes=first-last")]
Format = Literal["ply", "compressed.ply", "splat", "spz", "sog"]


class Asset(BaseModel):
    """One registered embedding."""

    id: str
    label: str
    copy_name: str = Field(description="Recipient of this copy.")
    owner_key_id: str
    record_id: str
    message: str = Field(description="Registered message, hexadecimal.")
    profile: str
    gaussians: int
    original_sha256: str
    original_format: str
    model_sha256: str
    model_format: str
    registered_at: str
    report: dict[str, Any] = Field(description="Measurements of the embedding.")


class AssetList(BaseModel):
    """A page of assets, newest first."""

    items: list[Asset]
    next: str | None


@router.get("", operation_id="listAssets", responses=responses("unauthorized", "forbidden", "invalid-request"))
def list_assets(core: Core, caller: Reader, limit: Limit = 20, after: After = "") -> AssetList:
    """Assets of this tenant, newest first."""
    with core.db.read() as connection:
        rows, following = page(connection, assets, caller.tenant, limit, after, "registered_at")
    return AssetList(items=[shape(row) for row in rows], next=following)


@router.get("/{asset_id}", operation_id="getAsset", responses=responses("unauthorized", "forbidden", "not-found"))
def get_asset(asset_id: str, core: Core, caller: Reader) -> Asset:
    """One asset."""
    return shape(own(core, caller.tenant, asset_id))


@router.get(
    "/{asset_id}/model",
    operation_id="getModel",
    response_class=Response,
    responses={
        **file_responses(MODEL_TYPE, 206),
        **responses("unauthorized", "forbidden", "not-found", "range-not-satisfiable", "invalid-request"),
    },
)
def get_model(
    asset_id: str,
    core: Core,
    caller: Reader,
    wanted: Annotated[Format | None, Query(alias="format", description="As stored if left out.")] = None,
    version: Annotated[Literal["marked", "original"], Query(description="Publish the marked one only.")] = "marked",
    range: Range = None,
) -> Response:
    """The marked model (or your original), converted where another format is asked for."""
    row = own(core, caller.tenant, asset_id)
    sha256, kind = (
        (row.model_sha256, row.model_format) if version == "marked" else (row.original_sha256, row.original_format)
    )
    if wanted is not None and wanted != kind:
        sha256, kind = convert(core, sha256, wanted), wanted
    return send_blob(core, sha256, f"{row.id}-{version}.{kind}", MODEL_TYPE, range)


@router.get(
    "/{asset_id}/record",
    operation_id="getRecord",
    response_class=Response,
    responses={
        **file_responses(RECORD_TYPE, 206),
        **responses("unauthorized", "forbidden", "not-found", "range-not-satisfiable"),
    },
)
def get_record(asset_id: str, core: Core, caller: Reader, range: Range = None) -> Response:
    """The sealed record: with the owner key it proves the mark without this service."""
    row = own(core, caller.tenant, asset_id)
    return send_blob(core, row.record_sha256, f"{row.id}.record", RECORD_TYPE, range)


@router.get(
    "/{asset_id}/preview.png",
    operation_id="getPreview",
    response_class=Response,
    responses={
        **file_responses("image/png", 206),
        **responses("unauthorized", "forbidden", "not-found", "range-not-satisfiable"),
    },
)
def get_preview(asset_id: str, core: Core, caller: Reader, range: Range = None) -> Response:
    """Original, marked, and twenty times their difference."""
    row = own(core, caller.tenant, asset_id)
    return send_blob(core, row.preview_sha256, f"{row.id}.png", "image/png", range)


def own(core: Service, tenant: str, asset_id: str) -> Any:
    """The row of an asset; not-found for other tenants' too."""
    mine = (assets.c.id == asset_id) & (assets.c.tenant == tenant)
    with core.db.read() as connection:
        row = connection.execute(sa.select(assets).where(mine)).first()
    if row is None:
        raise Problem("not-found", f"there is no asset {asset_id!r}")
    return row


def shape(row: Any) -> Asset:
    """The row for the client."""
    return Asset(
        id=row.id,
        label=row.label,
        copy_name=row.copy,
        owner_key_id=row.owner_key,
        record_id=row.record_id,
        message=row.message,
        profile=row.profile,
        gaussians=row.gaussians,
        original_sha256=row.original_sha256,
        original_format=row.original_format,
        model_sha256=row.model_sha256,
        model_format=row.model_format,
        registered_at=row.registered_at,
        report=json.loads(row.report),
    )
