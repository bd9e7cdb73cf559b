"""Files to clients: with Range and ETag, from the local folder or the store."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fastapi import Response
from fastapi.responses import FileResponse, StreamingResponse

from service.blobs import blob_name
from service.core import Service
from service.problems import Problem

MODEL_TYPE = "application/octet-stream"


def send_blob(
    service: Service, sha256: str, name: str, media_type: str, range_header: str | None
) -> Response:
    """A blob under a file name; its digest is its ETag."""
    headers = {"ETag": f'"{sha256}"', "Cache-Control": "private, max-age=3600"}
    if service.blobs.folder is not None:
        path = service.blobs.folder / blob_name(sha256)
        if not path.is_file():
            raise Problem("not-found", f"the file {sha256} is gone")
        return FileResponse(Path(path), media_type=media_type, filename=name, headers=headers)
    return _from_store(service, sha256, name, media_type, range_header, headers)


def _from_store(
    service: Service,
    sha256: str,
    name: str,
    media_type: str,
    range_header: str | None,
    headers: dict[str, str],
) -> Response:
    import obstore

    key = blob_name(sha256)
    size = int(obstore.head(service.blobs.store, key)["size"])
    headers |= {"Content-Disposition": f'attachment; filename="{name}"', "Accept-Ranges": "bytes"}
    first, last, status = 0, size - 1, 200
    if range_header is not None and (found := _one_range(range_header, size)) is not None:
        (first, last), status = found, 206
        headers["Content-Range"] = f"bytes {first}-{last}/{size}"
    headers["Content-Length"] = str(last + 1 - first)

    def chunks(step: int = 4 << 20) -> Iterator[bytes]:
        for start in range(first, last + 1, step):
            yield bytes(
                obstore.get_range(service.blobs.store, key, start=start, end=min(start + step, last + 1))
            )

    return StreamingResponse(chunks(), status, headers, media_type)


def _one_range(text: str, size: int) -> tuple[int, int] | None:
    """First and last byte of a single range; None for what is ignored, a problem for what cannot be."""
    unit, _, wanted = text.partition("=")
    low, dash, high = wanted.strip().partition("-")
    if unit.strip() != "bytes" or not dash or "," in wanted or not (low + high).isdigit():
        return None
    first = int(low) if low else max(0, size - int(high))
    last = min(int(high), size - 1) if low and high else size - 1
    if first > last:
        raise Problem(
            "range-not-satisfiable", f"{text!r} of {size} bytes", headers={"Content-Range": f"bytes */{size}"}
        )
    return first, last


def file_responses(media_type: str, *also: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI of a file, whole or in part."""
    schema = {"type": "string", "format": "binary"}
    content = {media_type: {"schema": schema}}
    found: dict[int | str, dict[str, Any]] = {200: {"description": "The file", "content": content}}
    if 206 in also:
        found[206] = {"description": "The part that Range asked for", "content": content}
    return found
