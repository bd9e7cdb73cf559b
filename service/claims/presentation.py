"""A claim as it is delivered: with its summary, as a page, as a pack."""

import base64
import json
from typing import Any

from fastapi import Response
from pydantic import BaseModel, Field

from service.claims.document import Summary, summary_of
from service.claims.schema import OwnerStatement
from service.core import Service
from service.http.error_responses import Responses

PACK_TYPE = "application/zip"
PAGE: Responses = {
    200: {"content": {"text/html": {"schema": {"type": "string"}}}, "description": "One page, all in it"}
}
ZIP: Responses = {
    200: {"content": {PACK_TYPE: {"schema": {"type": "string", "format": "binary"}}}, "description": "A ZIP"}
}
"""OpenAPI of the two files."""


class SignedClaim(BaseModel):
    """A claim: the document, and the signature over it."""

    document: dict[str, Any] = Field(description="What is signed (see docs/CLAIM.md).")
    jws: str = Field(description="Compact JWS over the document, Ed25519.")
    timestamp: str | None = Field(description="RFC 3161 token of the JWS, base64; null where none was made.")
    summary: Summary


def signed(row: Any) -> SignedClaim:
    """The claim of a row of the table `claims`."""
    stamp = base64.b64encode(row.timestamp).decode() if row.timestamp else None
    document = json.loads(row.document)
    return SignedClaim(document=document, jws=row.jws, timestamp=stamp, summary=summary_of(document))


def report_page(service: Service, row: Any) -> Response:
    """The claim as one page."""
    from service.claims.report import report_html

    pictures = {name: service.blobs.read(digest) for name, digest in json.loads(row.pictures).items()}
    return Response(report_html(json.loads(row.document), row.jws, pictures, row.timestamp), media_type="text/html")


def pack_file(service: Service, row: Any, given: OwnerStatement) -> Response:
    """The claim's pack; conflict where it recognised nothing."""
    from service.claims.pack import make_pack, shown_in_pack

    document, digests = json.loads(row.document), json.loads(row.pictures)
    pictures = {name: service.blobs.read(digests[name]) for name in shown_in_pack(digests)}
    headers = {"Content-Disposition": f'attachment; filename="{row.id}-pack.zip"', "Cache-Control": "no-store"}
    return Response(make_pack(document, row.jws, pictures, row.timestamp, given), headers=headers, media_type=PACK_TYPE)
