"""A claim as it is handed out: with its summary, as a page, as a pack."""

import base64
import json
from typing import Annotated, Any

from fastapi import Response
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, HttpUrl, StringConstraints, UrlConstraints

from service.claims.document import Summary, summary_of
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


def _without_password(url: HttpUrl) -> HttpUrl:
    if url.username or url.password:
        raise ValueError("leave user name and password out of the address")
    return url


# All of it goes into the line of one GET: at most 14 kB where every letter of the note takes nine, of the server's 16.
Url = Annotated[HttpUrl, UrlConstraints(max_length=400), AfterValidator(_without_password)]
Note = Annotated[str, StringConstraints(max_length=1000)]


class OwnerStatement(BaseModel):
    """What only the owner knows. It is put into the pack as the owner's word, and kept nowhere."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    copy_url: list[Url] = Field([], max_length=10, description="Where the copy was found; give it once for each place.")
    original_url: Url | None = Field(None, description="Where the original is published.")
    note: Note = Field("", description="Your own words; set off from what was found.")


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


def pack_file(service: Service, row: Any, told: OwnerStatement) -> Response:
    """The claim's pack; conflict where it recognised nothing."""
    from service.claims.pack import make_pack, shown_in_pack

    document, digests = json.loads(row.document), json.loads(row.pictures)
    pictures = {name: service.blobs.read(digests[name]) for name in shown_in_pack(digests)}
    headers = {"Content-Disposition": f'attachment; filename="{row.id}-pack.zip"', "Cache-Control": "no-store"}
    return Response(make_pack(document, row.jws, pictures, row.timestamp, told), headers=headers, media_type=PACK_TYPE)
