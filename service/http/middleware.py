"""Around every request: its id, the headers of its response, and what body it may bring, and how slowly."""

import asyncio
import secrets
from contextlib import suppress

from fastapi import HTTPException
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.core import Service
from service.http.access import identify
from service.problems import Problem
from service.settings import Settings

REQUEST_ID = "x-request-id"
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; connect-src 'self' blob: data:; worker-src 'self' blob:;"
    " style-src 'self' 'unsafe-inline'; script-src 'self' 'wasm-unsafe-eval'; frame-ancestors 'self';"
    " base-uri 'none'; form-action 'self'; object-src 'none'"
)
REPORT_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'self'"
API, UPLOADS = "/v1/", "/v1/uploads/"
BY_CONTENT = "/v1/matches/byContent"
SHARED = "/shared/"
"""Addresses that are secrets: kept out of caches, referrers and search engines."""
UNSEEN = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Robots-Tag": "noindex"}

GRACE_SECONDS, SLOWEST = 30.0, 8 << 10
"""A body may take GRACE_SECONDS, and a second more for each SLOWEST bytes of it: slower than any line in use."""
LINGER_SECONDS = 2.0


class SafeHeaders:
    """Middleware: what a browser may load, run and reveal (a report: less), and the request's id.

    The id is said in the response, in problems and in the log. HEAD is GET without the body (RFC 9110, 9.3.2).
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        head = scope["method"] == "HEAD" and not scope["path"].endswith("/events")  # a stream has no headers of its own
        scope = {**scope, "request_id": secrets.token_hex(8), "head": head}
        if scope["head"]:
            scope["method"] = "GET"

        async def tell(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                shared = scope["path"].startswith(SHARED)
                report = shared or scope["path"].endswith(("/report", "/annex"))
                headers.setdefault("Content-Security-Policy", REPORT_POLICY if report else POLICY)
                headers.setdefault("X-Content-Type-Options", "nosniff")
                headers.setdefault("Referrer-Policy", "no-referrer")
                headers.update(UNSEEN if shared else {})
                headers[REQUEST_ID] = scope["request_id"]
            elif scope["head"]:
                message = {**message, "body": b""}
            await send(message)

        await self.app(scope, receive, tell)


class BodyGuard:
    """Middleware: a body is read for a valid API key alone (401), while it is no longer than its kind may be (413) and
    comes no slower than SLOWEST (408). A connection whose body was not read to its end is closed."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self.settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope) if scope["type"] == "http" else Headers()
        announced = headers.get("content-length", "")
        if not announced.strip("0") and "transfer-encoding" not in headers:
            await self.app(scope, receive, send)
            return
        limit, count, is_read = self._limit(scope), 0, False
        began = asyncio.get_running_loop().time()

        async def guarded() -> Message:
            nonlocal count, is_read
            if is_read:
                return await receive()
            if not count and scope["path"].startswith(API):
                await asyncio.to_thread(_identify, scope["app"].state.service, headers)
            if announced.isdigit() and int(announced) > limit:
                raise HTTPException(413, f"a body of {announced} bytes exceeds the limit of {limit}")
            try:
                async with asyncio.timeout_at(began + GRACE_SECONDS + count / SLOWEST):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(408, f"{count} bytes came in {GRACE_SECONDS + count / SLOWEST:.0f} s") from None
            count += len(message.get("body", b""))
            if count > limit:
                raise HTTPException(413, f"the body exceeds the limit of {limit} bytes")
            is_read = not message.get("more_body", False)
            return message

        async def answered(message: Message) -> None:
            if message["type"] == "http.response.start" and not is_read:
                MutableHeaders(scope=message)["connection"] = "close"
            elif not is_read and not message.get("more_body", False):
                await send({**message, "more_body": True})
                await _linger(receive)
                message = {"type": "http.response.body"}
            await send(message)

        await self.app(scope, guarded, answered)

    def _limit(self, scope: Scope) -> int:
        if scope["method"] == "PUT" and scope["path"].startswith(UPLOADS):
            return self.settings.max_upload_bytes
        form = Headers(scope=scope).get("content-type", "").startswith("multipart/form-data")
        if form or scope["path"] == BY_CONTENT:
            return self.settings.max_form_bytes
        return self.settings.max_body_bytes


def _identify(service: Service, headers: Headers) -> None:
    """As HTTPException, which passes through the framework's reading of a body."""
    scheme, _, token = headers.get("authorization", "").partition(" ")
    try:
        identify(service, token if scheme.lower() == "bearer" else None)
    except Problem as problem:
        raise HTTPException(problem.status, problem.detail, problem.headers) from None


async def _linger(receive: Receive) -> None:
    """Discard what still comes. Closed at once, the connection would be reset before its client saw the answer."""
    with suppress(TimeoutError):
        async with asyncio.timeout(LINGER_SECONDS):
            while (await receive()).get("more_body", False):
                pass
