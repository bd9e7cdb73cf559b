"""The application: routes, middleware, static files. Made by a factory; nothing happens on import."""

import asyncio
import json
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.middleware.gzip import GZipMiddleware
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles

from service.acquisitions.endpoints import router as acquisitions
from service.assets.endpoints import router as assets
from service.assets.publishing import router as publishing
from service.assets.resolution import router as credentials
from service.claims.endpoints import packs
from service.claims.endpoints import router as claims
from service.claims.shares import router as shares
from service.core import Service
from service.disputes.endpoints import router as disputes
from service.embeds.endpoints import notices
from service.embeds.endpoints import router as embeds
from service.health import router as health
from service.http.access import check_address
from service.http.error_responses import install
from service.http.middleware import BodyGuard, SafeHeaders
from service.keys.api_keys import router as api_keys
from service.keys.endpoints import router as keys
from service.keys.me import router as me
from service.tracking import router as jobs
from service.uploads.endpoints import router as uploads
from service.verifications.endpoints import router as verifications
from service.webhooks.endpoints import router as webhooks

WEB = Path(__file__).parent / "web"
THREADS = 128
DESCRIPTION = """Ownership watermarks for 3D Gaussian Splatting models: mark a model under a key, and later prove,
with a bound on a false claim, whose mark a found model or screenshot carries. Extraction is informed: it uses the
record that was made at embedding."""

ROUTERS = (
    ("me", me),
    ("keys", keys),
    ("api-keys", api_keys),
    ("uploads", uploads),
    ("acquisitions", acquisitions),
    ("embeds", embeds),
    ("verifications", verifications),
    ("disputes", disputes),
    ("jobs", jobs),
    ("assets", assets),
    ("credentials", publishing),
    ("credentials", credentials),
    ("claims", claims),
    ("packs", packs),
    ("shares", shares),
    ("webhooks", webhooks),
    ("notices", notices),
    ("health", health),
)
"""In the order of the API's description."""

PROBLEM = {
    "type": "object",
    "title": "Problem",
    "description": "RFC 9457. `type` never changes its meaning.",
    "required": ["type", "title", "status", "detail", "request_id"],
    "properties": {
        "type": {"type": "string", "pattern": "^urn:mark3dgs:problem:[a-z-]+$"},
        "title": {"type": "string"},
        "status": {"type": "integer", "minimum": 400, "maximum": 599},
        "detail": {"type": "string"},
        "request_id": {"type": "string"},
    },
}


class _App(FastAPI):
    def openapi(self) -> dict[str, Any]:
        """The document, with our own error body in place of the framework's."""
        if self.openapi_schema is not None:
            return self.openapi_schema
        document = super().openapi()
        schemas = document.setdefault("components", {}).setdefault("schemas", {})
        for name in ("HTTPValidationError", "ValidationError"):
            schemas.pop(name, None)
        schemas["Problem"] = PROBLEM
        for methods in document["paths"].values():
            for operation in methods.values():
                if "HTTPValidationError" in json.dumps(operation["responses"].get("422", {})):
                    del operation["responses"]["422"]  # added by the framework where nothing can be invalid
        return document


def make_app(service: Service) -> FastAPI:
    """The application that serves a service."""

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        # Looks at uploads wait for their turn in these threads; with the default's few, everybody would wait for them.
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(THREADS))
        yield
        service.close()

    app = _App(
        title="Mark3DGS",
        version=version("mark3dgs"),
        description=DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        lifespan=life,
        dependencies=[Depends(check_address)],
        redirect_slashes=False,
    )
    app.state.service = service
    for name, router in ROUTERS:
        if service.settings.has_router(name):
            app.include_router(router)
    install(app)
    app.add_middleware(BodyGuard, settings=service.settings)
    app.add_middleware(SafeHeaders)

    @app.get("/", include_in_schema=False)
    def page() -> FileResponse:
        return FileResponse(WEB / "index.html")

    @app.get("/docs", include_in_schema=False)
    def docs() -> FileResponse:
        return FileResponse(WEB / "docs" / "index.html")

    app.mount("/static", GZipMiddleware(StaticFiles(directory=WEB), minimum_size=4096), name="static")
    return app
