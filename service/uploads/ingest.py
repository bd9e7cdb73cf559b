"""Bytes from the network to a file; complete uploads, looked at, so that nonsense is refused, and gathered."""

import asyncio
import hashlib
import json
import shutil
from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from starlette.datastructures import UploadFile
from starlette.requests import ClientDisconnect

from engine.formats.image_files import MAX_PIXELS_TOGETHER
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

    A request that breaks off leaves the bytes received, where the upload's size says that more is to come.
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
    (looked_at,) = await asyncio.to_thread(inspect, service, [row])
    return looked_at


def inspect(service: Service, rows: Sequence[Any]) -> list[Any]:
    """The rows of new uploads with what their files are: of pictures what their headers say, all in one process.

    What takes too long to say is left to the job. Where one is unreadable-model and the like, all are dropped.
    """
    infos: dict[str, Mapping[str, Any]] = {}
    with task_folder(service.settings) as folder:
        paths = {row.id: service.blobs.local(row.sha256, folder) for row in rows}
        kinds = {row.id: store.kind_of(paths[row.id], row.name) for row in rows}
        pictures = [row for row in rows if kinds[row.id] == "picture"]
        others = [row for row in rows if kinds[row.id] != "picture" and row.size <= INSPECTED_BYTES]
        try:
            if pictures:
                together = {"pictures": [str(paths[row.id]) for row in pictures]}
                found = _look(service, "pictures", together, folder, rows[0].tenant).get(
                    "pictures", [{}] * len(pictures)
                )
                infos |= {row.id: size for row, size in zip(pictures, found, strict=True)}
            for row in others:
                request = {kinds[row.id]: str(paths[row.id]), "spz_frame": "auto", "name": row.name}
                task = "inspect" if kinds[row.id] == "model" else "cameras"
                infos[row.id] = _look(service, task, request, folder, row.tenant)
        except Problem as problem:
            if problem.status < 500:
                for row in rows:
                    store.drop(service, row)
            raise
    names = ("format", "gaussians", "sh_degree", "repairs", "width", "height", "cameras")
    facts = {key: {name: info[name] for name in names if name in info} for key, info in infos.items()}
    return [store.note(service, row, {"kind": kinds[row.id], **facts.get(row.id, {})}) for row in rows]


def _look(service: Service, task: str, request: Mapping[str, Any], folder: Path, tenant: str) -> Mapping[str, Any]:
    return run_once(service.settings, task, request, folder, service.settings.inspect_seconds, tenant) or {}


def gather(
    service: Service, caller: Caller, upload_ids: Sequence[str], files: Sequence[UploadFile], kind: str
) -> list[Any]:
    """Rows of the complete uploads that a request names, and of those that its files become.

    conflict where an upload is not complete, unreadable-... where it is no model, picture or cameras as `kind` says.
    """
    rows = [complete_upload(service, caller, upload_id) for upload_id in upload_ids]
    if files:
        rows += inspect(service, [_take(service, caller, file) for file in files])
    infos = [json.loads(row.info) if row.info else {} for row in rows]
    for row, info in zip(rows, infos, strict=True):
        if (found := info.get("kind", kind)) != kind:
            text = f"{row.name or row.id!r} is no {kind}: its bytes are those of a {found} file"
            where = "; POST /v1/verify takes pictures as 'images', uploads of them as 'image_upload_ids'"
            raise Problem(WRONG_KIND[kind], text + (where if found == "picture" else ""))
    together = sum(info.get("width", 0) * info.get("height", 0) for info in infos)
    if together > MAX_PIXELS_TOGETHER:
        text = f"the pictures have {together:,} pixels together, more than {MAX_PIXELS_TOGETHER:,}"
        raise Problem("unreadable-image", text)
    return rows


def _take(service: Service, caller: Caller, file: UploadFile) -> Any:
    """The row of the upload that a form's file became; nothing is known of it yet."""
    try:
        name = check_text(PurePosixPath((file.filename or "").replace("\\", "/")).name[:200])
    except ValueError as error:
        raise Problem("invalid-request", f"name of a file: {error}") from None
    with service.blobs.new_file() as path:
        with path.open("wb") as target:
            shutil.copyfileobj(file.file, target, _CHUNK)
        size = path.stat().st_size
        row = store.create(service, caller, name, size or None, None)
        return store.complete(service, row, path, Received(size, digest_of(path), whole=True))


def complete_upload(service: Service, caller: Caller, upload_id: str) -> Any:
    """The row of a complete upload; conflict where it is not."""
    row = store.get(service, caller, upload_id)
    if row.state != "complete":
        raise Problem("conflict", f"upload {upload_id!r} is not complete: {row.received} bytes are here")
    return row
