"""Bodies are counted as they come in, sized or chunked, and refused once they are too long."""

from fastapi import HTTPException
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.settings import Settings

UPLOADS = "/v1/uploads/"


class BodyLimit:
    """Middleware: 413 for a body over the limit of its kind (upload, form, other)."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self.settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = self._limit(scope)
        announced = Headers(scope=scope).get("content-length", "")
        count = 0

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
