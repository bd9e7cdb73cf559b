"""/v1/assets: what was marked, and its files.

A record goes out with this service's signed statement of its registration, so that the date counts elsewhere, too.
"""

import asyncio
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from engine.records.attestation import LOG, Attestation, attach, header_digest
from engine.records.signatures import REGISTRATION
from service.assets.content_credentials import delivered, forget_manifests
from service.assets.conversions import converted, drop, keep, kept
from service.core import Service
from service.db import holding, own
from service.db.schema import assets
from service.http.access import Admin, After, Core, Follower, Limit, Listed, OriginalsReader, Reader, Words, visible
from service.http.error_responses import OF_LIST, OF_OWN
from service.http.file_responses import MODEL_TYPE, Want, file_responses, send_blob
from service.http.forms import FROM_JSON
from service.http.results import Time
from service.problems import Problem
from service.trust import audit
from service.trust.canonical import canonical
from service.trust.commitments import forget, registration_of
from service.trust.signing import sign

router = APIRouter(prefix="/v1/assets", tags=["assets"])
RECORD_TYPE = "application/vnd.mark3dgs.record"
Format = Literal["ply", "compressed.ply", "splat", "spz", "sog", "glb", "usdc", "usdz"]


class Asset(BaseModel):
    """One registered embedding."""

    model_config = ConfigDict(from_attributes=True)
    id: str
    label: str
    copy_name: str = Field(validation_alias="copy", description="Recipient of this copy.")
    owner_key_id: str = Field(validation_alias="owner_key")
    record_id: str
    message: str = Field(description="Registered message, hexadecimal.")
    profile: str
    gaussians: int
    original_sha256: str
    original_format: str
    model_sha256: str
    model_format: str
    registered_at: Time
    report: Annotated[dict[str, Any], FROM_JSON] = Field(description="Measurements of the embedding.")


class AssetList(Listed[Asset]):
    """A page of assets, newest first."""


@router.get("", operation_id="listAssets", responses=OF_LIST)
def list_assets(
    core: Core,
    caller: Reader,
    limit: Limit = 20,
    after: After = "",
    q: Annotated[Words, Query(description="Text in the label, copy name, id or record id.")] = "",
    original: Annotated[str | None, Query(pattern="^[0-9a-f]{64}$", description="Copies of this original.")] = None,
) -> AssetList:
    """Assets of this tenant, newest first."""
    where = holding(q, *(assets.c[name] for name in ("label", "copy", "id", "record_id")))
    where = where if original is None else where & (assets.c.original_sha256 == original)
    return AssetList.of(core, assets, caller.tenant, limit, after, time="registered_at", where=where)


@router.get("/{asset_id}", operation_id="getAsset", responses=OF_OWN)
def get_asset(asset_id: str, core: Core, caller: Follower) -> Asset:
    """One asset."""
    return Asset.model_validate(visible(core, caller, assets, asset_id))


@router.get(
    "/{asset_id}/model",
    operation_id="getModel",
    response_class=Response,
    responses=file_responses(MODEL_TYPE, "invalid-request", "budget-exceeded"),
)
async def get_model(
    asset_id: str,
    core: Core,
    caller: Follower,
    want: Want,
    wanted: Annotated[Format | None, Query(alias="format", description="As stored if left out.")] = None,
    version: Annotated[Literal["marked", "original"], Query(description="Publish the marked one only.")] = "marked",
) -> Response:
    """The marked model (or your original), converted to another `format` if requested.

    Where the operator signs Content Credentials, a marked .sog has them inside, and the header Link leads to those of
    a .sog or .glb.
    """
    row, marked = await asyncio.to_thread(visible, core, caller, assets, asset_id), version == "marked"
    if not marked and not caller.may("originals"):
        raise Problem("forbidden", "this API key lacks the scope 'originals', which the unmarked original needs")
    sha256, kind = (row.model_sha256, row.model_format) if marked else (row.original_sha256, row.original_format)
    if wanted is not None and wanted != kind:
        sha256, kind = await converted(core, caller.tenant, sha256, wanted), wanted
    ending = "ply" if kind == "spacetime" else kind  # a clip is one
    file = await delivered(core, row, sha256, kind if marked else "")
    answer = await asyncio.to_thread(send_blob, core, file.sha256, f"{row.id}-{version}.{ending}", MODEL_TYPE, want)
    answer.headers.update(file.headers)
    return answer


@router.get(
    "/{asset_id}/record", operation_id="getRecord", response_class=Response, responses=file_responses(RECORD_TYPE)
)
def get_record(asset_id: str, core: Core, caller: OriginalsReader, want: Want) -> Response:
    """The sealed record, with this service's signed statement of its registration: with the owner key it proves the
    mark without this service, at 1 in 10^9 for anyone who trusts its public keys."""
    row = own(core.db, assets, caller.tenant, asset_id)
    return send_blob(core, attested_record(core, row), f"{row.id}.record", RECORD_TYPE, want)


@router.get(
    "/{asset_id}/preview.png", operation_id="getPreview", response_class=Response, responses=file_responses("image/png")
)
def get_preview(asset_id: str, core: Core, caller: Follower, want: Want) -> Response:
    """Original, marked, and twenty times their difference."""
    row = visible(core, caller, assets, asset_id)
    return send_blob(core, row.preview_sha256, f"{row.id}.png", "image/png", want)


@router.delete("/{asset_id}", status_code=204, operation_id="deleteAsset", responses=OF_OWN)
def delete_asset(asset_id: str, core: Core, caller: Admin) -> None:
    """Delete an asset for good, with its record: its mark can never be claimed again. Claims about it stay; its files
    go with the next tidying up. The log keeps that it was registered, and that it was deleted."""
    row = own(core.db, assets, caller.tenant, asset_id)
    forget(core.db, assets, caller.tenant, asset_id)
    forget_manifests(core, asset_id)
    drop(core, row.model_sha256, row.original_sha256, row.record_sha256)


_FORMAT = "attested record"


def attested_record(service: Service, row: Any) -> str:
    """Digest of an asset's record with the log's proof attached; made once."""
    if (found := kept(service, row.record_sha256, _FORMAT)) is not None:
        return found
    data = service.blobs.read(row.record_sha256)
    with service.db.read() as connection:
        entry = registration_of(connection, row.id)
        said = {"header_sha256": header_digest(data), **audit.proven(connection, entry)}
        statement = sign(connection, service.master, canonical(said), REGISTRATION)
    with service.blobs.new_file() as file:
        file.write_bytes(attach(data, Attestation(LOG, statement)))
        digest = service.blobs.put(file)
    keep(service, row.record_sha256, _FORMAT, digest)
    return digest
