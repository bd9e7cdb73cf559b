"""One message to one address, which a tenant chose: never into our own network (`service.open_network`), never for
long. No redirects, no proxy, of the answer the status alone.
"""

import asyncio

import httpx

from service.open_network import NOWHERE, resolve, there

SECONDS = 10.0
"""For all of it: resolving, connecting, sending, and the answer's headers."""

DELIVERED = "delivered"


async def send(url: str, body: bytes, headers: dict[str, str], *, private: bool = False) -> tuple[int | None, str]:
    """Post a message; status of the answer (None where there is none) and the outcome in words.

    `private`: to any address, and over plain HTTP.
    """
    try:
        async with asyncio.timeout(SECONDS):
            return await _post(httpx.URL(url), body, headers, private)
    except (TimeoutError, httpx.TimeoutException):
        return None, f"no answer within {SECONDS:.0f} s"
    except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
        return None, f"no answer: {type(error).__name__}"


async def _post(url: httpx.URL, body: bytes, headers: dict[str, str], private: bool) -> tuple[int | None, str]:
    address = await resolve(url, private=private)
    if address is None or not (private or url.scheme == "https"):
        return None, NOWHERE
    target, of_name, extensions = there(url, address)
    async with (
        httpx.AsyncClient(trust_env=False, verify=httpx.create_ssl_context(), timeout=SECONDS) as client,
        client.stream("POST", target, content=body, headers=headers | of_name, extensions=extensions) as answer,
    ):
        return answer.status_code, DELIVERED if answer.is_success else f"answered {answer.status_code}"
