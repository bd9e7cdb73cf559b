"""A server on this machine that answers GET as a test wants, and names that lead where a test wants."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler
from typing import Any

import pytest

from tests.service.webhooks.receiver import Behaviour, listen

Names = dict[str, list[str]]


def answer(body: bytes, status: int = 200, **headers: str) -> Behaviour:
    """Answer so, always; an underscore in a header's name is a hyphen."""

    def behave(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        for name, value in ({"Content_Length": str(len(body))} | headers).items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.wfile.write(body)

    return behave


class Site:
    """A server; `got` are the paths of its requests."""

    def __init__(self, behave: Behaviour, context: ssl.SSLContext | None = None) -> None:
        self.got: list[str] = []
        site = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                site.got.append(self.path)
                try:
                    behave(self)
                except OSError:  # the client has left
                    self.close_connection = True

            def log_message(self, *_: Any) -> None:
                """Say nothing."""

        self.server = listen(Handler, context)
        self.port = int(self.server.server_address[1])

    def url(self, path: str = "/", name: str = "127.0.0.1") -> str:
        return f"http://{name}:{self.port}{path}"


@pytest.fixture
def sites() -> Iterator[Callable[..., Site]]:
    made: list[Site] = []

    def make(behave: Behaviour, context: ssl.SSLContext | None = None) -> Site:
        made.append(Site(behave, context))
        return made[-1]

    yield make
    for site in made:
        site.server.shutdown()
        site.server.server_close()


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> Names:
    """Addresses of names; what is none of them is an address."""
    known: Names = {}

    async def getaddrinfo(self: Any, host: str, port: int, **_: Any) -> list[Any]:
        found = known.get(host, [host])
        return [(socket.AF_INET6 if ":" in each else socket.AF_INET, 1, 6, "", (each, port)) for each in found]

    monkeypatch.setattr(asyncio.BaseEventLoop, "getaddrinfo", getaddrinfo)
    return known
