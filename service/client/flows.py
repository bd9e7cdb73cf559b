"""What the client can do, each a flow of `wire`: the same for both drivers."""

import hashlib
import os
import secrets
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypedDict, TypeVar, Unpack
from urllib.parse import quote

from service.client.answers import (
    Acquisition,
    Asset,
    Claim,
    ClaimSummary,
    Embedded,
    Job,
    Me,
    Notice,
    Share,
    Upload,
    Verified,
    Webhook,
    embedded,
    read,
    verified,
)
from service.client.errors import ServiceError
from service.client.wire import BREAKS, FIRST_PAUSE, Flow, Params, Pause, Progress, Reply, Request, Work, ask

PIECE = 8 << 20
"""Bytes of one request: what a broken connection costs at most."""

Source = str | os.PathLike[str] | bytes
"""A file's path, or its content."""


@dataclass(frozen=True)
class Measured:
    """What is announced of a source before it is sent."""

    name: str
    size: int
    sha256: str


def measure(source: Source) -> Measured:
    """Name, size and digest; OSError where the file cannot be read."""
    if isinstance(source, bytes):
        return Measured("", len(source), hashlib.sha256(source).hexdigest())
    path = Path(source)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return Measured(path.name[:200], file.tell(), digest)


def piece(source: Source, start: int) -> bytes:
    """The bytes from `start` on, at most PIECE."""
    if isinstance(source, bytes):
        return source[start : start + PIECE]
    with Path(source).open("rb") as file:
        file.seek(start)
        return file.read(PIECE)


def digest_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


A = TypeVar("A")
State = Literal["queued", "running", "succeeded", "disputed", "failed", "cancelled"]

FIRST_LOOK, LONGEST_LOOK = 0.1, 2.0
"""Seconds between looks at a job: doubled while nothing changes."""
LOOKS = 10
"""At an upload that is whole, and of which nothing is known yet."""


class EmbedOptions(TypedDict, total=False):
    """Of POST /v1/embed, as the API's description has them; what is left out is the service's default."""

    key_id: str
    message: str
    bits: int
    profile: Literal["fast", "balanced", "strong", "auto", "paper", "paper-appendix"]
    survive: Literal["model", "pictures", "worst"]
    psnr: float
    budget: float
    output: Literal["fidelity", "compact"]
    format: Literal["ply", "compressed.ply", "splat", "spz", "sog", "glb"]
    copy_name: str
    label: str
    spz_frame: Literal["auto", "spec", "ply"]


class VerifyOptions(TypedDict, total=False):
    """Of POST /v1/verify; without `asset_id` the suspect is compared with all assets of the tenant."""

    asset_id: str
    acquisition_id: str
    false_claim_rate: float
    suspect_seen: str  # YYYY-MM-DD
    route: Literal["auto", "model", "render", "image"]
    spz_frame: Literal["auto", "spec", "ply"]


def silent(stage: str, fraction: float) -> None:
    """Progress that is not reported."""


def call(method: str, path: str, *, json: Any = None, params: Params | None = None) -> Flow[Any]:
    """Any request of the API: the JSON of its answer, None where it has no body. ServiceError for a bad answer."""
    reply = yield from ask(Request(method, path, params or {}, json=json))
    return reply.json() if reply.body else None


def upload(source: Source, *, progress: Progress = silent) -> Flow[Upload]:
    """Send a file, by pieces. What an earlier try left, of this process or another, is not sent again.

    Parameters
    ----------
    source : path or bytes
    progress : callable
        Called with "upload" and the share that is there.

    Returns
    -------
    Upload
        Complete, with `info` on what the file is.
    """
    announced: Measured = yield Work(partial(measure, source))
    slot = yield from _slot(announced)
    path, breaks = address("uploads", slot.id), 0
    while slot.state == "open":
        data: bytes = yield Work(partial(piece, source, slot.offset))
        if not data:
            raise ServiceError("changed", f"{announced.name!r} became shorter while it was sent")
        headers = {"Upload-Offset": str(slot.offset), "Content-Type": "application/octet-stream"}
        reply: Reply = yield Request("PUT", path, headers=headers, content=data)
        if not reply.good and reply.status not in (0, 408, 409):
            raise reply.error()
        # No answer: some of it may have come, or all. 408: too slow a line. 409: another process sends the same file.
        before, slot = slot, read(Upload, reply.json() if reply.good else (yield from _look(path)))
        breaks = breaks + 1 if slot.offset == before.offset else 0
        if breaks > BREAKS:
            raise reply.error()
        if breaks:
            yield Pause(FIRST_PAUSE * breaks)
        progress("upload", slot.offset / max(announced.size, 1))
    for _ in range(LOOKS):  # its answer was lost, and the service still looks at what came
        if slot.info is not None:
            break
        yield Pause(2 * FIRST_PAUSE)
        slot = read(Upload, (yield from _look(path)))
    return slot


def _slot(announced: Measured) -> Flow[Upload]:
    """An open upload of these very bytes, or a new one."""
    listed = yield from _get("/v1/uploads", {"limit": "100"})
    for plain in listed["items"]:
        slot = read(Upload, plain)
        if (slot.state, slot.size, slot.sha256) == ("open", announced.size, announced.sha256):
            return slot
    body = {"name": announced.name, "size": announced.size, "sha256": announced.sha256}
    return read(Upload, (yield from call("POST", "/v1/uploads", json=body)))


def submit_embed(
    model: Source, *, cameras: Source | None = None, progress: Progress = silent, **options: Unpack[EmbedOptions]
) -> Flow[Job]:
    """Upload a model, and the cameras to mark it for, and start the job that marks it."""
    named: dict[str, object] = {"upload_id": (yield from upload(model, progress=progress)).id}
    if cameras is not None:
        named["cameras_upload_id"] = (yield from upload(cameras)).id
    return read(Job, (yield from _once("/v1/embed", {**named, **options})))


def submit_verify(
    suspect: Source | Sequence[Source],
    *,
    cameras: Source | None = None,
    progress: Progress = silent,
    **options: Unpack[VerifyOptions],
) -> Flow[Job]:
    """Upload a suspect - a model, a picture, or several pictures of one - and start the job that checks it."""
    ids, kind = [], ""
    for source in [suspect] if isinstance(suspect, str | bytes | os.PathLike) else suspect:
        sent = yield from upload(source, progress=progress)
        ids.append(sent.id)
        kind = (sent.info or {}).get("kind", "")
    named: dict[str, object] = {"upload_id": ids[0]} if len(ids) == 1 and kind == "model" else {"image_upload_ids": ids}
    if cameras is not None:
        named["cameras_upload_id"] = (yield from upload(cameras)).id
    return read(Job, (yield from _once("/v1/verify", {**named, **options})))


def _once(path: str, body: Mapping[str, object]) -> Flow[Any]:
    # The service knows the key again: a request whose answer was lost is done once, not twice.
    headers = {"Idempotency-Key": secrets.token_hex(16)}
    return (yield from ask(Request("POST", path, headers=headers, json=body, again=True))).json()


def job(job_id: str) -> Flow[Job]:
    """A job and its state."""
    return read(Job, (yield from _get(address("jobs", job_id))))


def wait(job_id: str, *, progress: Progress = silent, timeout: float | None = None) -> Flow[Job]:
    """A job once it has ended, however it did; ServiceError "timed-out" after `timeout` seconds: it continues.

    A connection that breaks meanwhile is made anew.
    """
    until = None if timeout is None else time.monotonic() + timeout
    etag, pause = "", FIRST_LOOK
    while True:
        headers = {"If-None-Match": etag} if etag else {}
        reply: Reply = yield Request("GET", address("jobs", job_id), headers=headers, again=True)
        if reply.status != 304:
            if not reply.good:
                raise reply.error()
            found, etag, pause = read(Job, reply.json()), reply.headers.get("etag", ""), FIRST_LOOK
            progress(found.stage, found.fraction)
            if found.ended:
                return found
        if until is not None and time.monotonic() + pause > until:
            text = f"job {job_id} has not ended within {timeout:g} s; it continues"
            raise ServiceError("timed-out", text, values={"job": job_id})
        yield Pause(pause)
        pause = min(2 * pause, LONGEST_LOOK)


def cancel(job_id: str) -> Flow[Job]:
    """Stop a job; ServiceError "conflict" where it has ended."""
    return read(Job, (yield from call("DELETE", address("jobs", job_id))))


def embed(
    model: Source,
    *,
    cameras: Source | None = None,
    progress: Progress = silent,
    timeout: float | None = None,
    **options: Unpack[EmbedOptions],
) -> Flow[Embedded]:
    """Upload a model, have it marked, and wait; ServiceError if it fails (`values["job"]`: the job)."""
    started = yield from submit_embed(model, cameras=cameras, progress=progress, **options)
    return embedded((yield from wait(started.id, progress=progress, timeout=timeout)))


def verify(
    suspect: Source | Sequence[Source],
    *,
    cameras: Source | None = None,
    progress: Progress = silent,
    timeout: float | None = None,
    **options: Unpack[VerifyOptions],
) -> Flow[Verified]:
    """Upload a suspect - a model, a picture, or several pictures of one - and wait for the signed answer."""
    started = yield from submit_verify(suspect, cameras=cameras, progress=progress, **options)
    return verified((yield from wait(started.id, progress=progress, timeout=timeout)))


def asset(asset_id: str) -> Flow[Asset]:
    """One asset."""
    return read(Asset, (yield from _get(address("assets", asset_id))))


def claim(claim_id: str) -> Flow[Claim]:
    """A claim, with its signature."""
    return read(Claim, (yield from _get(address("claims", claim_id))))


def me() -> Flow[Me]:
    """The API key of this client, its scopes, and the use of its tenant's limits."""
    return read(Me, (yield from call("GET", "/v1/me")))


def assets(*, q: str = "", original: str = "") -> Flow[list[Asset]]:
    """Assets of the tenant: all, whose label, copy name, id or record id holds `q`, or of one original (SHA-256)."""
    return (yield from _all(Asset, "/v1/assets", {"q": q, "original": original}))


def claims(
    *, q: str = "", verdict: Literal["", "marked", "not_marked", "inconclusive"] = "", asset: str = ""
) -> Flow[list[ClaimSummary]]:
    """Claims of the tenant: all; with a verdict; about the asset of an id; or found by `q`, a part of a suspect's file
    name, of an id, label or copy name, or a suspect's SHA-256."""
    return (yield from _all(ClaimSummary, "/v1/claims", {"q": q, "verdict": verdict, "asset": asset}))


def jobs(*, state: Sequence[State] = (), kind: Literal["", "embed", "verify", "dispute"] = "") -> Flow[list[Job]]:
    """Jobs of the tenant: all, in one of some states, or of a kind."""
    return (yield from _all(Job, "/v1/jobs", {"state": state, "kind": kind}))


def share(claim_id: str, *, days: int = 14) -> Flow[Share]:
    """Make a share of a claim for 1 to 90 days; its `url` is shown only once."""
    return read(Share, (yield from call("POST", address("claims", claim_id, "share"), json={"days": days})))


def shares(claim_id: str) -> Flow[list[Share]]:
    """Active shares of a claim, newest first."""
    found = yield from call("GET", address("claims", claim_id, "shares"))
    return [read(Share, each) for each in found["items"]]


def revoke_share(share_id: str) -> Flow[None]:
    """Revoke a share."""
    yield from call("DELETE", address("shares", share_id))


def acquire(source: Source, *, progress: Progress = silent) -> Flow[Acquisition]:
    """Have the service fetch a suspect from an address (http, https), or take a file, and preserve it unchanged."""
    if isinstance(source, str) and source.startswith(("http://", "https://")):
        body = {"url": source}
    else:
        body = {"upload_id": (yield from upload(source, progress=progress)).id}
    return read(Acquisition, (yield from _once("/v1/acquisitions", body)))


def acquisition(acquisition_id: str) -> Flow[Acquisition]:
    """One acquisition."""
    return read(Acquisition, (yield from _get(address("acquisitions", acquisition_id))))


def acquisitions() -> Flow[list[Acquisition]]:
    """All acquisitions of the tenant."""
    return (yield from _all(Acquisition, "/v1/acquisitions", {}))


def notices(*, asset: str = "") -> Flow[list[Notice]]:
    """Uploads of other accounts in which a mark of the tenant was found: all, or about the asset of an id."""
    return (yield from _all(Notice, "/v1/notices", {"asset": asset}))


def add_webhook(url: str, *, events: Sequence[str] = ("job.ended", "mark.found")) -> Flow[Webhook]:
    """Send a message to an address at the end of every job of the tenant, and when a mark of it is found in an upload;
    its `secret` is shown only once."""
    return read(Webhook, (yield from call("POST", "/v1/webhooks", json={"url": url, "events": list(events)})))


def webhooks() -> Flow[list[Webhook]]:
    """Webhooks of the tenant, with the outcome of the last message to each."""
    found = yield from call("GET", "/v1/webhooks")
    return [read(Webhook, each) for each in found["items"]]


def delete_webhook(webhook_id: str) -> Flow[None]:
    """Delete a webhook."""
    yield from call("DELETE", address("webhooks", webhook_id))


def _look(path: str) -> Flow[Any]:
    """As `_get`, again where no answer comes."""
    return (yield from ask(Request("GET", path, again=True))).json()


def _get(path: str, params: Params | None = None) -> Flow[Any]:
    return (yield from call("GET", path, params=params))


def address(kind: str, *parts: str) -> str:
    """Path of one thing, or of what belongs to it; an id is never more than one part of a path."""
    return "/".join((f"/v1/{kind}", *(quote(part, safe="") for part in parts)))


def _all(kind: type[A], path: str, narrowed: Mapping[str, str | Sequence[str]]) -> Flow[list[A]]:
    found: list[A] = []
    given = {name: value for name, value in narrowed.items() if value}
    after: str | None = ""
    while after is not None:
        page = yield from call("GET", path, params={"limit": "100", "after": after, **given})
        found += [read(kind, each) for each in page["items"]]
        after = page["next"]
    return found
