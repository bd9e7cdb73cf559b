"""Files of the service, written whole or not at all."""

import os
import re
import secrets
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import BinaryIO, Literal
from urllib.parse import quote

from service.client.errors import ServiceError
from service.client.flows import digest_of, silent
from service.client.wire import BREAKS, FIRST_PAUSE, Fetch, Flow, Params, Pause, Progress, Reply, Request, Work

Target = str | os.PathLike[str]


def download(
    asset_id: str,
    target: Target,
    *,
    format: Literal["ply", "compressed.ply", "splat", "spz", "sog", "glb"] | None = None,
    version: Literal["marked", "original"] = "marked",
    progress: Progress = silent,
) -> Flow[Path]:
    """Fetch a model to a file, converted if a `format` is given. See `_fetch` for the file."""
    params: dict[str, str] = {"version": version} | ({"format": format} if format else {})
    return (yield from _fetch(f"/v1/assets/{quote(asset_id, safe='')}/model", target, params, progress))


def record(asset_id: str, target: Target) -> Flow[Path]:
    """Fetch the sealed record of an asset to a file."""
    return (yield from _fetch(f"/v1/assets/{quote(asset_id, safe='')}/record", target, {}, silent))


def report(claim_id: str, target: Target) -> Flow[Path]:
    """Fetch a claim as one page (HTML) to a file."""
    return (yield from _fetch(f"/v1/claims/{quote(claim_id, safe='')}/report", target, {}, silent))


def jws(claim_id: str, target: Target) -> Flow[Path]:
    """Fetch the signed claim alone to a file, for `mark3dgs verify-report` and third parties."""
    return (yield from _fetch(f"/v1/claims/{quote(claim_id, safe='')}.jws", target, {}, silent))


def pack(
    claim_id: str,
    target: Target,
    *,
    law: Literal["dmca", "dsa"] | None = None,
    copy_url: Sequence[str] = (),
    original_url: str = "",
    note: str = "",
) -> Flow[Path]:
    """Fetch the documents for a platform (ZIP) to a file; with a `law`, the statements that it requires are in it."""
    given = {"law": law or "", "copy_url": copy_url, "original_url": original_url, "note": note}
    params = {name: value for name, value in given.items() if value}
    return (yield from _fetch(f"/v1/claims/{quote(claim_id, safe='')}/pack", target, params, silent))


def warc(acquisition_id: str, target: Target) -> Flow[Path]:
    """Fetch the WARC file of an acquisition to a file."""
    return (yield from _fetch(f"/v1/acquisitions/{quote(acquisition_id, safe='')}/warc", target, {}, silent))


def _fetch(path: str, target: Target, params: Params, progress: Progress) -> Flow[Path]:
    """The file, which appears under its name, or takes an older one's place, only once it is whole.

    A broken connection is continued where it broke; the digest, where the service names one (ETag), is checked.
    """
    goal = Path(target)
    part = goal.with_name(f".{goal.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            etag = yield from _fill(file, Request("GET", path, params), progress)
            file.flush()
            yield Work(partial(os.fsync, file.fileno()))
        announced = re.fullmatch(r'"([0-9a-f]{64})"', etag)
        if announced and (found := (yield Work(partial(digest_of, part)))) != announced[1]:
            raise ServiceError("digest-mismatch", f"{path} came with SHA-256 {found}, announced was {announced[1]}")
        part.replace(goal)
    finally:
        part.unlink(missing_ok=True)
    return goal


def _fill(file: BinaryIO, request: Request, progress: Progress) -> Flow[str]:
    """Write an answer to a file; its ETag."""
    etag, breaks = "", 0
    while True:
        have = file.tell()
        # If-Range: of the same file, or the whole of what is there by now. No encoding: parts are counted in bytes.
        part = {"Range": f"bytes={have}-", "If-Range": etag} if have and etag else {}
        wanted = Request(request.method, request.path, request.params, {"Accept-Encoding": "identity", **part})
        reply: Reply = yield Fetch(wanted, file, progress)
        etag = reply.headers.get("etag", etag)
        if reply.good:
            return etag
        breaks = breaks + 1 if file.tell() <= have else 1
        if reply.status != 0 or not file.tell() or breaks > BREAKS:
            raise reply.error()
        yield Pause(FIRST_PAUSE * breaks)
