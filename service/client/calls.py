"""What the client can do, but for downloads, on a line of `wire`."""

import hashlib
import os
import secrets
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
from service.client.wire import BREAKS, FIRST_PAUSE, Line, Params, Progress, Request

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


def address(kind: str, *parts: str) -> str:
    """Path of one thing, or of what belongs to it; an id is never more than one part of a path."""
    return "/".join((f"/v1/{kind}", *(quote(part, safe="") for part in parts)))


class Calls(Line):
    """What the client can do but for downloads."""

    def call(self, method: str, path: str, *, json: Any = None, params: Params | None = None) -> Any:
        """Any request of the API: the JSON of its answer, None where it has no body. ServiceError for a bad answer."""
        reply = self._ask(Request(method, path, params or {}, json=json))
        return reply.json() if reply.body else None

    def upload(self, source: Source, *, progress: Progress = silent) -> Upload:
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
        announced = measure(source)
        slot = self._slot(announced)
        path, breaks = address("uploads", slot.id), 0
        while slot.state == "open":
            data = piece(source, slot.offset)
            if not data:
                raise ServiceError("changed", f"{announced.name!r} became shorter while it was sent")
            headers = {"Upload-Offset": str(slot.offset), "Content-Type": "application/octet-stream"}
            reply = self._send(Request("PUT", path, headers=headers, content=data))
            if not reply.good and reply.status not in (0, 408, 409):
                raise reply.error()
            # No answer: some of it may have come, or all. 408: too slow a line. 409: another process sends this file.
            before, slot = slot, read(Upload, reply.json() if reply.good else self._look(path))
            breaks = breaks + 1 if slot.offset == before.offset else 0
            if breaks > BREAKS:
                raise reply.error()
            if breaks:
                time.sleep(FIRST_PAUSE * breaks)
            progress("upload", slot.offset / max(announced.size, 1))
        for _ in range(LOOKS):  # its answer was lost, and the service still looks at what came
            if slot.info is not None:
                break
            time.sleep(2 * FIRST_PAUSE)
            slot = read(Upload, self._look(path))
        return slot

    def _slot(self, announced: Measured) -> Upload:
        """An open upload of these very bytes, or a new one."""
        listed = self.call("GET", "/v1/uploads", params={"limit": "100"})
        for plain in listed["items"]:
            slot = read(Upload, plain)
            if (slot.state, slot.size, slot.sha256) == ("open", announced.size, announced.sha256):
                return slot
        body = {"name": announced.name, "size": announced.size, "sha256": announced.sha256}
        return read(Upload, self.call("POST", "/v1/uploads", json=body))

    def submit_embed(
        self,
        model: Source,
        *,
        cameras: Source | None = None,
        progress: Progress = silent,
        **options: Unpack[EmbedOptions],
    ) -> Job:
        """Upload a model, and the cameras to mark it for, and start the job that marks it."""
        named: dict[str, object] = {"upload_id": (self.upload(model, progress=progress)).id}
        if cameras is not None:
            named["cameras_upload_id"] = (self.upload(cameras)).id
        return read(Job, self._once("/v1/embed", {**named, **options}))

    def submit_verify(
        self,
        suspect: Source | Sequence[Source],
        *,
        cameras: Source | None = None,
        progress: Progress = silent,
        **options: Unpack[VerifyOptions],
    ) -> Job:
        """Upload a suspect - a model, a picture, or several pictures of one - and start the job that checks it."""
        ids, kind = [], ""
        for source in [suspect] if isinstance(suspect, str | bytes | os.PathLike) else suspect:
            sent = self.upload(source, progress=progress)
            ids.append(sent.id)
            kind = (sent.info or {}).get("kind", "")
        named: dict[str, object] = (
            {"upload_id": ids[0]} if len(ids) == 1 and kind == "model" else {"image_upload_ids": ids}
        )
        if cameras is not None:
            named["cameras_upload_id"] = (self.upload(cameras)).id
        return read(Job, self._once("/v1/verify", {**named, **options}))

    def _once(self, path: str, body: Mapping[str, object]) -> Any:
        # The service knows the key again: a request whose answer was lost is done once, not twice.
        headers = {"Idempotency-Key": secrets.token_hex(16)}
        return (self._ask(Request("POST", path, headers=headers, json=body, again=True))).json()

    def job(self, job_id: str) -> Job:
        """A job and its state."""
        return read(Job, self.call("GET", address("jobs", job_id)))

    def wait(self, job_id: str, *, progress: Progress = silent, timeout: float | None = None) -> Job:
        """A job once it has ended, however it did; ServiceError "timed-out" after `timeout` seconds: it continues.

        A connection that breaks meanwhile is made anew.
        """
        until = None if timeout is None else time.monotonic() + timeout
        etag, pause = "", FIRST_LOOK
        while True:
            headers = {"If-None-Match": etag} if etag else {}
            reply = self._send(Request("GET", address("jobs", job_id), headers=headers, again=True))
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
            time.sleep(pause)
            pause = min(2 * pause, LONGEST_LOOK)

    def cancel(self, job_id: str) -> Job:
        """Stop a job; ServiceError "conflict" where it has ended."""
        return read(Job, self.call("DELETE", address("jobs", job_id)))

    def embed(
        self,
        model: Source,
        *,
        cameras: Source | None = None,
        progress: Progress = silent,
        timeout: float | None = None,
        **options: Unpack[EmbedOptions],
    ) -> Embedded:
        """Upload a model, have it marked, and wait; ServiceError if it fails (`values["job"]`: the job)."""
        started = self.submit_embed(model, cameras=cameras, progress=progress, **options)
        return embedded(self.wait(started.id, progress=progress, timeout=timeout))

    def verify(
        self,
        suspect: Source | Sequence[Source],
        *,
        cameras: Source | None = None,
        progress: Progress = silent,
        timeout: float | None = None,
        **options: Unpack[VerifyOptions],
    ) -> Verified:
        """Upload a suspect - a model, a picture, or several pictures of one - and wait for the signed answer."""
        started = self.submit_verify(suspect, cameras=cameras, progress=progress, **options)
        return verified(self.wait(started.id, progress=progress, timeout=timeout))

    def asset(self, asset_id: str) -> Asset:
        """One asset."""
        return read(Asset, self.call("GET", address("assets", asset_id)))

    def claim(self, claim_id: str) -> Claim:
        """A claim, with its signature."""
        return read(Claim, self.call("GET", address("claims", claim_id)))

    def me(self) -> Me:
        """The API key of this client, its scopes, and the use of its tenant's limits."""
        return read(Me, self.call("GET", "/v1/me"))

    def assets(self, *, q: str = "", original: str = "") -> list[Asset]:
        """Assets of the tenant: all, with `q` in label, copy name, id or record id, or of one original (SHA-256)."""
        return self._all(Asset, "/v1/assets", {"q": q, "original": original})

    def claims(
        self, *, q: str = "", verdict: Literal["", "marked", "not_marked", "inconclusive"] = "", asset: str = ""
    ) -> list[ClaimSummary]:
        """Claims of the tenant: all; with a verdict; about the asset of an id; or found by `q`, a part of a suspect's
        file name, of an id, label or copy name, or a suspect's SHA-256."""
        return self._all(ClaimSummary, "/v1/claims", {"q": q, "verdict": verdict, "asset": asset})

    def jobs(self, *, state: Sequence[State] = (), kind: Literal["", "embed", "verify", "dispute"] = "") -> list[Job]:
        """Jobs of the tenant: all, in one of some states, or of a kind."""
        return self._all(Job, "/v1/jobs", {"state": state, "kind": kind})

    def share(self, claim_id: str, *, days: int = 14) -> Share:
        """Make a share of a claim for 1 to 90 days; its `url` is shown only once."""
        return read(Share, self.call("POST", address("claims", claim_id, "share"), json={"days": days}))

    def shares(self, claim_id: str) -> list[Share]:
        """Active shares of a claim, newest first."""
        found = self.call("GET", address("claims", claim_id, "shares"))
        return [read(Share, each) for each in found["items"]]

    def revoke_share(self, share_id: str) -> None:
        """Revoke a share."""
        self.call("DELETE", address("shares", share_id))

    def acquire(self, source: Source, *, progress: Progress = silent) -> Acquisition:
        """Have the service fetch a suspect from an address (http, https), or take a file, and preserve it unchanged."""
        if isinstance(source, str) and source.startswith(("http://", "https://")):
            body = {"url": source}
        else:
            body = {"upload_id": (self.upload(source, progress=progress)).id}
        return read(Acquisition, self._once("/v1/acquisitions", body))

    def acquisition(self, acquisition_id: str) -> Acquisition:
        """One acquisition."""
        return read(Acquisition, self.call("GET", address("acquisitions", acquisition_id)))

    def acquisitions(self) -> list[Acquisition]:
        """All acquisitions of the tenant."""
        return self._all(Acquisition, "/v1/acquisitions", {})

    def notices(self, *, asset: str = "") -> list[Notice]:
        """Uploads of other accounts in which a mark of the tenant was found: all, or about the asset of an id."""
        return self._all(Notice, "/v1/notices", {"asset": asset})

    def add_webhook(self, url: str, *, events: Sequence[str] = ("job.ended", "mark.found")) -> Webhook:
        """Send a message to an address at the end of every job of the tenant, and when a mark of it is found in an
        upload; its `secret` is shown only once."""
        return read(Webhook, self.call("POST", "/v1/webhooks", json={"url": url, "events": list(events)}))

    def webhooks(self) -> list[Webhook]:
        """Webhooks of the tenant, with the outcome of the last message to each."""
        found = self.call("GET", "/v1/webhooks")
        return [read(Webhook, each) for each in found["items"]]

    def delete_webhook(self, webhook_id: str) -> None:
        """Delete a webhook."""
        self.call("DELETE", address("webhooks", webhook_id))

    def _look(self, path: str) -> Any:
        """The answer to GET, which is sent again where none comes."""
        return (self._ask(Request("GET", path, again=True))).json()

    def _all(self, kind: type[A], path: str, narrowed: Mapping[str, str | Sequence[str]]) -> list[A]:
        found: list[A] = []
        given = {name: value for name, value in narrowed.items() if value}
        after: str | None = ""
        while after is not None:
            page = self.call("GET", path, params={"limit": "100", "after": after, **given})
            found += [read(kind, each) for each in page["items"]]
            after = page["next"]
        return found
