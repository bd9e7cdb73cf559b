"""Files of a multipart form become uploads like any other: complete, inspected, owned by the caller."""

import json
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Any

from starlette.datastructures import UploadFile

from service.blobs import digest_of
from service.core import Service
from service.problems import Problem
from service.uploads import store
from service.uploads.inspection import inspect

WRONG_KIND = {"model": "unreadable-model", "picture": "unreadable-image", "cameras": "unreadable-cameras"}
_CHUNK = 1 << 20


def take(service: Service, tenant: str, file: UploadFile) -> Any:
    """The row of the upload that a form's file became."""
    name = PurePosixPath((file.filename or "").replace("\\", "/")).name[:200]
    with service.blobs.new_file() as path:
        with path.open("wb") as target:
            while chunk := file.file.read(_CHUNK):
                target.write(chunk)
        size = path.stat().st_size
        row = store.create(service, tenant, name, size or None, None)
        return inspect(service, store.complete(service, row, path, size, digest_of(path)))


def expect(rows: Sequence[Any], kind: str) -> None:
    """Refuse uploads that are something else than a model, a picture or cameras, as the request needs them."""
    for row in rows:
        found = json.loads(row.info)["kind"] if row.info else kind
        if found != kind:
            raise Problem(WRONG_KIND[kind], f"upload {row.id!r} is no {kind}: its bytes are those of a {found} file")


def whole(service: Service, tenant: str, upload_id: str) -> Any:
    """The row of a complete upload."""
    row = store.get(service, tenant, upload_id)
    if row.state != "complete":
        raise Problem("conflict", f"upload {upload_id!r} is not complete: {row.received} bytes are here")
    return row
