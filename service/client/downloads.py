"""Files of the service, written whole or not at all."""

import os
import re
import secrets
import time
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Literal

from service.client.calls import Calls, address, digest_of, silent
from service.client.errors import ServiceError
from service.client.wire import BREAKS, FIRST_PAUSE, Params, Progress, Request, Sink

Target = str | os.PathLike[str]


class Client(Calls):
    """A tenant's client of one service, with all calls and downloads; closes its connections at the end of a `with`.

    See `Line` for its parameters.
    """

    def download(
        self,
        asset_id: str,
        target: Target,
        *,
        format: Literal["ply", "compressed.ply", "splat", "spz", "sog", "glb", "usdc", "usdz"] | None = None,
        version: Literal["marked", "original"] = "marked",
        progress: Progress = silent,
    ) -> Path:
        """Fetch a model to a file, converted if a `format` is given. See `_fetch` for the file."""
        params: dict[str, str] = {"version": version} | ({"format": format} if format else {})
        return self._fetch(address("assets", asset_id, "model"), target, params, progress)

    def record(self, asset_id: str, target: Target) -> Path:
        """Fetch the sealed record of an asset to a file."""
        return self._fetch(address("assets", asset_id, "record"), target, {}, silent)

    def report(self, claim_id: str, target: Target) -> Path:
        """Fetch a claim as one page (HTML) to a file."""
        return self._fetch(address("claims", claim_id, "report"), target, {}, silent)

    def annex(self, claim_id: str, target: Target) -> Path:
        """Fetch how often the method errs, as one page (HTML) beside the report, to a file."""
        return self._fetch(address("claims", claim_id, "annex"), target, {}, silent)

    def jws(self, claim_id: str, target: Target) -> Path:
        """Fetch the signed claim alone to a file, for `mark3dgs verify-report` and third parties."""
        return self._fetch(address("claims", f"{claim_id}.jws"), target, {}, silent)

    def pack(
        self,
        claim_id: str,
        target: Target,
        *,
        law: Literal["dmca", "dsa"] | None = None,
        copy_url: Sequence[str] = (),
        original_url: str = "",
        note: str = "",
    ) -> Path:
        """Fetch the documents for a platform (ZIP) to a file; a `law` adds the statements that it requires."""
        given = {"law": law or "", "copy_url": copy_url, "original_url": original_url, "note": note}
        params = {name: value for name, value in given.items() if value}
        return self._fetch(address("claims", claim_id, "pack"), target, params, silent)

    def warc(self, acquisition_id: str, target: Target) -> Path:
        """Fetch the WARC file of an acquisition to a file."""
        return self._fetch(address("acquisitions", acquisition_id, "warc"), target, {}, silent)

    def _fetch(self, path: str, target: Target, params: Params, progress: Progress) -> Path:
        """The file, which appears under its name, or takes an older one's place, only once it is whole.

        A broken connection is continued where it broke; the digest, where the service names one (ETag), is checked.
        """
        goal = Path(target)
        part = goal.with_name(f".{goal.name}.{secrets.token_hex(4)}.part")
        try:
            with part.open("xb") as file:
                etag = self._fill(file, Request("GET", path, params), progress)
                file.flush()
                os.fsync(file.fileno())
            announced = re.fullmatch(r'"([0-9a-f]{64})"', etag)
            if announced and (found := digest_of(part)) != announced[1]:
                raise ServiceError("digest-mismatch", f"{path} came with SHA-256 {found}, announced was {announced[1]}")
            part.replace(goal)
        finally:
            part.unlink(missing_ok=True)
        return goal

    def _fill(self, file: BinaryIO, request: Request, progress: Progress) -> str:
        """Write an answer to a file; its ETag."""
        etag, breaks = "", 0
        while True:
            have = file.tell()
            # If-Range: of the same file, or the whole of what is there by now. No encoding: parts are counted in bytes.
            part = {"Range": f"bytes={have}-", "If-Range": etag} if have and etag else {}
            wanted = Request(request.method, request.path, request.params, {"Accept-Encoding": "identity", **part})
            reply = self._send(wanted, Sink(file, progress))
            etag = reply.headers.get("etag", etag)
            if reply.good:
                return etag
            breaks = breaks + 1 if file.tell() <= have else 1
            if reply.status != 0 or not file.tell() or breaks > BREAKS:
                raise reply.error()
            time.sleep(FIRST_PAUSE * breaks)
