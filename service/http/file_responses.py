"""Files to clients: with Range and ETag, from the local folder or the store alike."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

import obstore
from fastapi import Depends, Header, Request, Response
from fastapi.responses import StreamingResponse

from service.blobs import blob_name
from service.core import Service
from service.http.error_responses import Responses, responses
from service.problems import Problem

MODEL_TYPE = "application/octet-stream"
TEXT, BINARY = {"schema": {"type": "string"}}, {"schema": {"type": "string", "format": "binary"}}
_CHUNK = 4 << 20


@dataclass(frozen=True)
class Wanted:
    """What a client wants of a file."""

    part: str | None  # Range
    of: str | None  # If-Range: only of the file with this ETag
    known: tuple[str, ...]  # ETags of the files at hand
    head: bool  # the headers alone


def _wanted(
    request: Request,
    range: Annotated[str | None, Header(description="bytes=first-last")] = None,
    if_range: Annotated[str | None, Header(description="ETag of the file that the range is of.")] = None,
    if_none_match: Annotated[str | None, Header(description="ETag of the file that you have.")] = None,
) -> Wanted:
    return Wanted(range, if_range, tags(if_none_match), request.scope["head"])


Want = Annotated[Wanted, Depends(_wanted)]


def tags(header: str | None) -> tuple[str, ...]:
    """ETags of an If-None-Match, which compares weakly (RFC 9110, 13.1.2)."""
    return tuple(tag.strip().removeprefix("W/") for tag in (header or "").split(","))


def send_blob(service: Service, sha256: str, name: str, media_type: str, want: Wanted) -> Response:
    """A blob under a file name, or the part of it that is wanted; its digest is its ETag."""
    store, key = service.blobs.store, blob_name(sha256)
    try:
        size = int(obstore.head(store, key)["size"])
    except FileNotFoundError:
        raise Problem("not-found", f"the file {sha256} is gone") from None
    etag = f'"{sha256}"'
    headers = {
        "ETag": etag,
        "Cache-Control": "private, max-age=3600",
        "Content-Disposition": f'attachment; filename="{name}"',
        "Accept-Ranges": "bytes",
    }
    if {etag, "*"}.intersection(want.known):
        return Response(status_code=304, headers=headers)
    first, last, status = 0, size - 1, 200
    part = want.part if want.of in (None, etag) else None
    if (found := _one_range(part or "", size)) is not None:
        (first, last), status = found, 206
        headers["Content-Range"] = f"bytes {first}-{last}/{size}"
    headers["Content-Length"] = str(last + 1 - first)
    if want.head:
        return Response(None, status, headers, media_type)

    def chunks() -> Iterator[bytes]:
        for start in range(first, last + 1, _CHUNK):
            yield bytes(obstore.get_range(store, key, start=start, end=min(start + _CHUNK, last + 1)))

    return StreamingResponse(chunks(), status, headers, media_type)


def _one_range(text: str, size: int) -> tuple[int, int] | None:
    """First and last byte of `bytes=...`; None for no range, several, or none that can be read (RFC 9110, 14.2)."""
    found = re.fullmatch(r"\s*bytes\s*=\s*(\d{0,18})\s*-\s*(\d{0,18})\s*", text, re.ASCII)
    if found is None or not (found[1] or found[2]):
        return None
    first = int(found[1]) if found[1] else max(0, size - int(found[2]))
    last = min(int(found[2]), size - 1) if found[1] and found[2] else size - 1
    if first >= size:
        headers = {"Content-Range": f"bytes */{size}"}
        raise Problem("range-not-satisfiable", f"{text!r} of {size} bytes", headers=headers)
    return (first, last) if first <= last else None


def one_file(media_type: str, description: str, schema: Mapping[str, object] = BINARY) -> Responses:
    """OpenAPI of an answer that is a file."""
    return {200: {"content": {media_type: schema}, "description": description}}


def file_responses(media_type: str, *also: str) -> Responses:
    """OpenAPI of a file of one's own, whole or in part, and of the problems instead of it."""
    return {
        **one_file(media_type, "The file"),
        206: {"description": "The range requested by Range", "content": {media_type: BINARY}},
        304: {"description": "Not modified (If-None-Match)"},
        **responses("unauthorized", "forbidden", "not-found", "range-not-satisfiable", *also),
    }
