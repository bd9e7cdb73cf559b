"""One message to one address, which a stranger chose: never into our own network, never for long.

The name is resolved once, every address it has is looked at, and the connection goes to one of these: a name that
resolves otherwise a moment later changes nothing. No redirects, no proxy, of the answer the status alone.
"""

import asyncio
import ipaddress
import socket

import httpx

SECONDS = 10.0
"""For all of it: resolving, connecting, sending, and the answer's headers."""

DELIVERED = "delivered"
NOWHERE = "the name has no address, or one that is not public"
"""Said alike of both: names of the operator's network are not for tenants to find out."""


async def send(url: str, body: bytes, headers: dict[str, str], *, private: bool = False) -> tuple[int | None, str]:
    """Post a message; status of the answer (None where there is none) and what came of it in words.

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
    address = await _address(url, private)
    if address is None or not (private or url.scheme == "https"):
        return None, NOWHERE
    # The certificate must be that of the name, though we connect to the address that was looked at.
    there, certified = url.copy_with(host=address), {"sni_hostname": url.raw_host.decode()}
    headers = {**headers, "Host": url.netloc.decode()}
    async with (
        httpx.AsyncClient(trust_env=False, verify=httpx.create_ssl_context(), timeout=SECONDS) as client,
        client.stream("POST", there, content=body, headers=headers, extensions=certified) as answer,
    ):
        return answer.status_code, DELIVERED if answer.is_success else f"answered {answer.status_code}"


async def _address(url: httpx.URL, private: bool) -> str | None:
    """Where to connect; None where the name has no address, or where one of them is not public and needs to be."""
    port = url.port or {"https": 443, "http": 80}[url.scheme]
    loop = asyncio.get_running_loop()
    try:
        found = await loop.getaddrinfo(url.raw_host.decode(), port, type=socket.SOCK_STREAM)
    except OSError:
        return None
    addresses = [str(entry[4][0]) for entry in found]
    return addresses[0] if addresses and (private or all(map(is_public, addresses))) else None


def is_public(address: str) -> bool:
    """Whether an IP address is one of the open network.

    Not so an address of IPv6 that stands for one of IPv4, which a gateway may take back in.
    """
    ip = ipaddress.ip_address(address)
    if isinstance(ip, ipaddress.IPv6Address) and (ip.is_site_local or ip.ipv4_mapped or ip.sixtofour):
        return False
    return ip.is_global and not (ip.is_multicast or ip.is_reserved)
