"""Addresses that a tenant chose: where they lead, if that is on the open network.

A name is resolved once, every address it has is looked at, and the connection goes to one of these: a name that
resolves otherwise a moment later changes nothing.
"""

import asyncio
import ipaddress
import socket

import httpx

NOWHERE = "the name has no address, or one that is not public"
"""Said alike of both: names of the operator's network are not for tenants to find out."""


async def resolve(url: httpx.URL, *, private: bool = False) -> str | None:
    """Where to connect; None where the name has no address, or, unless `private` ones will do, one that is not public.

    `url` is of http or https.
    """
    port = url.port or {"https": 443, "http": 80}[url.scheme]
    loop = asyncio.get_running_loop()
    try:
        found = await loop.getaddrinfo(url.raw_host.decode(), port, type=socket.SOCK_STREAM)
    except OSError:
        return None
    addresses = [str(entry[4][0]) for entry in found]
    return addresses[0] if addresses and (private or all(map(is_public, addresses))) else None


def there(url: httpx.URL, address: str) -> tuple[httpx.URL, dict[str, str], dict[str, str]]:
    """What to request of an address that was looked at: URL, headers and httpx's extensions.

    The certificate must be that of the name.
    """
    return url.copy_with(host=address), {"Host": url.netloc.decode()}, {"sni_hostname": url.raw_host.decode()}


def is_public(address: str) -> bool:
    """Whether an IP address is one of the open network.

    Not so an address of IPv6 that stands for one of IPv4, which a gateway may take back in.
    """
    ip = ipaddress.ip_address(address)
    if isinstance(ip, ipaddress.IPv6Address) and (ip.is_site_local or ip.ipv4_mapped or ip.sixtofour):
        return False
    return ip.is_global and not (ip.is_multicast or ip.is_reserved)
