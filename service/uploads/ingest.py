"""Bytes from the network to a file; complete uploads, looked at, so that nonsense is refused, and gathered."""

import asyncio
import hashlib
import json
import shutil
from collections.abc import AsyncIterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from starlette.datastructures import UploadFile
from starlette.requests import ClientDisconnect

from service.blobs import digest_of
from service.core import Service
from service.http.forms import check_text
from service.problems import Problem
from service.processes import run_once, task_folder
from service.trust.api_keys import Caller
from service.uploads import store
from service.uploads.store import Received

BATCH = 4 << 20
"""Bytes handed to the disk at once: large enough that threads cost nothing, small enough for memory."""

WRONG_KIND = {"model": "unreadable-model", "picture": "unreadable-image", "cameras": "unreadable-cameras"}
INSPECTED_BYTES = 256 << 20
"""Larger files are read by their job only."""
_CHUNK = 1 << 20


async def receive(stream: AsyncIterator[bytes], path: Path, room: int) -> Received:
    """Write a request's body to a new file, hashed on the way, in threads; too-large when more than `room` bytes come.

    A client that breaks off leaves what came so far.
    """
    digest, length, whole = hashlib.sha256(), 0, True
    with path.open("wb") as file:

        def store(batch: bytes) -> None:
            digest.update(batch)
            file.write(batch)

        pending: asyncio.Future[None] | None = None
        buffer = bytearray()
        try:
            async for chunk in stream:
                length += len(chunk)
                if length > room:
                    raise Problem("too-large", f"more bytes came than the {room} that were left to come")
                buffer += chunk
                if len(buffer) >= BATCH:
                    if pending is not None:
                        await pending
                    pending = asyncio.ensure_future(asyncio.to_thread(store, bytes(buffer)))
                    buffer.clear()
        except ClientDisconnect:
            whole = False
        finally:
            if pending is not None:
                await pending
        await asyncio.to_thread(store, bytes(buffer))
    return Received(length, digest.hexdigest(), whole)


async def take(service: Service, row: Any, stream: AsyncIterator[bytes]) -> Any:
    """The row of an upload with the bytes of a request added; once it is complete, with what the file is.

    A request that breaks off leaves what came of it, where the upload's size says that more is to come.
    """
    room = await asyncio.to_thread(store.room, service, row)
    with service.blobs.new_file() as path:
        got = await receive(stream, path, room)
        if not got.length and got.whole:
            raise Problem("invalid-request", "no bytes were sent")
        if row.size is None and not got.whole:
            return row
        if row.size is not None and got.length < room:
            return await asyncio.to_thread(store.add_part, service, row, path, got) if got.length else row
        row = await asyncio.to_thread(store.complete, service, row, path, got)
    return await asyncio.to_thread(inspect, service, row)


def inspect(service: Service, row: Any) -> Any:
    """The row with what the file is. What takes too long to say is left to the job.

    Where it is unreadable-model and the like, the upload is dropped.
    """
    with task_folder(service.settings) as folder:
        path = service.blobs.local(row.sha256, folder)
        kind = store.kind_of(path, row.name)
        if row.size > INSPECTED_BYTES:
            return store.note(service, row, {"kind": kind})
        request = {kind: str(path), "spz_frame": "auto"}
        task = "inspect" if kind == "model" else kind
        try:
            found = run_once(service.settings, task, request, folder, service.settings.inspect_seconds, row.tenant)
        except Problem as problem:
            if problem.status < 500:
                store.drop(service, row)
            raise
        if found is None:
            return store.note(service, row, {"kind": kind})
    names = ("format", "gaussians", "sh_degree", "repairs", "width", "height", "cameras")
    info = {"kind": kind, **{name: found[name] for name in names if name in found}}
    return store.note(service, row, info)


def gather(
    service: Service, caller: Caller, upload_ids: Sequence[str], files: Sequence[UploadFile], kind: str
) -> list[Any]:
    """Rows of the complete uploads that a request names, and of those that its files become.

    conflict where an upload is not complete, unreadable-... where it is no model, picture or cameras as `kind` says.
    """
    rows = [_whole(service, caller, upload_id) for upload_id in upload_ids]
    rows += [_take(service, caller, file) for file in files]
    for row in rows:
        found = json.loads(row.info)["kind"] if row.info else kind
        if found != kind:
            raise Problem(WRONG_KIND[kind], f"upload {row.id!r} is no {kind}: its bytes are those of a {found} file")
    return rows


def _take(service: Service, caller: Caller, file: UploadFile) -> Any:
    """The row of the upload that a form's file became."""
    try:
        name = check_text(PurePosixPath((file.filename or "").replace("\\", "/")).name[:200])
    except ValueError as error:
        raise Problem("invalid-request", f"name of a file: {error}") from None
    with service.blobs.new_file() as path:
        with path.open("wb") as target:
            shutil.copyfileobj(file.file, target, _CHUNK)
        size = path.stat().st_size
        row = store.create(service, caller, name, size or None, None)
        return inspect(service, store.complete(service, row, path, Received(size, digest_of(path), whole=True)))


def _whole(service: Service, caller: Caller, upload_id: str) -> Any:
    """The row of a complete upload."""
    row = store.get(service, caller, upload_id)
    if row.state != "complete":
        raise Problem("conflict", f"upload {upload_id!r} is not complete: {row.received} bytes are here")
    return row
