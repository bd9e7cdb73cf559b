"""Around every request: its id, the headers of its response, and how long its body may be."""

import secrets

from fastapi import HTTPException
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.settings import Settings

REQUEST_ID = "x-request-id"
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; connect-src 'self' blob: data:; worker-src 'self' blob:;"
    " style-src 'self' 'unsafe-inline'; script-src 'self' 'wasm-unsafe-eval'; frame-ancestors 'self';"
    " base-uri 'none'; form-action 'self'; object-src 'none'"
)
REPORT_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'self'"
UPLOADS = "/v1/uploads/"
SHARED = "/shared/"
"""Addresses that are secrets: kept out of caches, referrers and search engines."""
UNSEEN = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Robots-Tag": "noindex"}


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
        scope = {**scope, "request_id": secrets.token_hex(8), "head": _is_head(scope)}
        if scope["head"]:
            scope["method"] = "GET"

        async def tell(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                shared = scope["path"].startswith(SHARED)
                report = shared or scope["path"].endswith("/report")
                headers.setdefault("Content-Security-Policy", REPORT_POLICY if report else POLICY)
                headers.setdefault("X-Content-Type-Options", "nosniff")
                headers.setdefault("Referrer-Policy", "no-referrer")
                headers.update(UNSEEN if shared else {})
                headers[REQUEST_ID] = scope["request_id"]
            elif scope["head"]:
                message = {**message, "body": b""}
            await send(message)

        await self.app(scope, receive, tell)


def _is_head(scope: Scope) -> bool:
    return scope["method"] == "HEAD" and not scope["path"].endswith("/events")  # a stream has no headers of its own


class BodyLimit:
    """Middleware: 413 for a body over the limit of its kind (upload, form, other), counted as it comes in."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self.settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit, count = self._limit(scope), 0
        announced = Headers(scope=scope).get("content-length", "")

        async def counted() -> Message:
            nonlocal count
            if announced.isdigit() and int(announced) > limit:
                raise HTTPException(413, f"a body of {announced} bytes exceeds the limit of {limit}")
            message = await receive()
            count += len(message.get("body", b""))
            if count > limit:
                raise HTTPException(413, f"the body exceeds the limit of {limit} bytes")
            return message

        await self.app(scope, counted, send)

    def _limit(self, scope: Scope) -> int:
        if scope["method"] == "PUT" and scope["path"].startswith(UPLOADS):
            return self.settings.max_upload_bytes
        if Headers(scope=scope).get("content-type", "").startswith("multipart/form-data"):
            return self.settings.max_form_bytes
        return self.settings.max_body_bytes
