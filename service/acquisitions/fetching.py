"""What an address on the open network answers: no proxy, no cookies, no encoding; each redirect is checked anew."""

import asyncio
import ssl
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import httpx

from service.clock import now
from service.open_network import NOWHERE, resolve, there
from service.problems import Problem
from service.uploads.ingest import receive
from service.uploads.store import Received

MOST_REDIRECTS = 5
TOOL = f"mark3dgs/{version('mark3dgs')}"


@dataclass(frozen=True)
class Exchange:
    """One request and its answer, but for the body."""

    url: str
    at: str  # of the request, UTC, ISO 8601
    address: str  # IP address
    target: str  # of the request line
    request_headers: tuple[tuple[str, str], ...]  # headers as sent
    status: str  # such as "200 OK"
    answered: tuple[tuple[str, str], ...]  # headers as they came
    certificates: tuple[bytes, ...]  # of the server (DER), its own first; before Python 3.13 that one alone


async def fetch(
    url: str, target: Path, most_bytes: int, seconds: float, *, private: bool = False
) -> tuple[list[Exchange], Received]:
    """Fetch to a file. All redirects and then the answer whose body it is; what was stored of it.

    `private`: addresses that are not public will do. "not-fetched" where there is no such answer within `seconds`,
    "too-large" where it has more than `most_bytes`.
    """
    found: list[Exchange] = []
    following: str | None = url
    try:
        async with asyncio.timeout(seconds):
            while following is not None:
                if len(found) > MOST_REDIRECTS:
                    raise Problem("not-fetched", f"{url} leads to more than {MOST_REDIRECTS} redirects")
                exchange, following, got = await _get(httpx.URL(following), target, most_bytes, seconds, private)
                found.append(exchange)
        return found, got
    except (TimeoutError, httpx.TimeoutException):
        raise Problem("not-fetched", f"{url} did not answer in full within {seconds:g} s") from None
    except (httpx.HTTPError, httpx.InvalidURL, ssl.SSLError, UnicodeError) as error:
        raise Problem("not-fetched", f"{url} gave no answer: {type(error).__name__}: {error}") from None


async def _get(
    url: httpx.URL, target: Path, most_bytes: int, seconds: float, private: bool
) -> tuple[Exchange, str | None, Received]:
    """One answer, where it redirects to, and what was stored of its body."""
    if url.scheme not in ("http", "https") or url.userinfo or not url.host:
        raise Problem("not-fetched", f"{url} is no http(s) address, or has a user name in it")
    if (address := await resolve(url, private=private)) is None:
        raise Problem("not-fetched", f"{url.copy_with(query=None)}: {NOWHERE}")
    goal, headers, extensions = there(url, address)
    headers |= {"User-Agent": TOOL, "Accept": "*/*", "Accept-Encoding": "identity"}
    at = now()
    async with (
        httpx.AsyncClient(trust_env=False, verify=httpx.create_ssl_context(), timeout=seconds) as client,
        client.stream("GET", goal, headers=headers, extensions=extensions) as answer,
    ):
        exchange = Exchange(
            url=str(url),
            at=at,
            address=address,
            target=url.raw_path.decode(),
            request_headers=_plain(answer.request.headers),
            status=f"{answer.status_code} {answer.reason_phrase}",
            answered=_plain(answer.headers),
            certificates=_certificates(answer),
        )
        if answer.has_redirect_location:
            return exchange, str(url.join(answer.headers["Location"])), Received(0, "", whole=False)
        if answer.status_code != httpx.codes.OK:
            raise Problem("not-fetched", f"{url} answered {answer.status_code}")
        if (encoding := answer.headers.get("Content-Encoding", "identity")) != "identity":
            raise Problem("not-fetched", f"{url} answered in the encoding {encoding}, though none was accepted")
        return exchange, None, await receive(answer.aiter_raw(), target, most_bytes)


def _plain(headers: httpx.Headers) -> tuple[tuple[str, str], ...]:
    return tuple((name.decode("latin-1"), value.decode("latin-1")) for name, value in headers.raw)


def _certificates(answer: httpx.Response) -> tuple[bytes, ...]:
    tls = answer.extensions["network_stream"].get_extra_info("ssl_object")
    if tls is None:
        return ()
    if hasattr(tls, "get_unverified_chain"):
        return tuple(tls.get_unverified_chain())
    return (tls.getpeercert(binary_form=True),)
