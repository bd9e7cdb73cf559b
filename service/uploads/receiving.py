"""Bytes from the network to a file: hashed on the way, in threads, at the speed of the disk."""

import asyncio
import hashlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from starlette.requests import ClientDisconnect

from service.problems import Problem

BATCH = 4 << 20
"""Bytes handed to the disk at once: large enough that threads cost nothing, small enough for memory."""


@dataclass(frozen=True)
class Received:
    """What came: bytes, their digest, and whether the client said that was all."""

    length: int
    sha256: str
    whole: bool


async def receive(stream: AsyncIterator[bytes], path: Path, room: int) -> Received:
    """Write a request's body to a new file; a client that breaks off leaves what came so far.

    Raises
    ------
    Problem
        too-large when more than `room` bytes come.
    """
    digest, length, whole = hashlib.sha256(), 0, True
    with path.open("wb") as file:

        def store(batch: bytes) -> None:
            digest.update(batch)
            file.write(batch)

        pending: asyncio.Future[None] | None = None
        buffer = bytearray()
        try:
            async for chunk in stream:
                length += len(chunk)
                if length > room:
                    raise Problem("too-large", f"more bytes came than the {room} that were left to come")
                buffer += chunk
                if len(buffer) >= BATCH:
                    if pending is not None:
                        await pending
                    pending = asyncio.ensure_future(asyncio.to_thread(store, bytes(buffer)))
                    buffer.clear()
        except ClientDisconnect:
            whole = False
        finally:
            if pending is not None:
                await pending
        await asyncio.to_thread(store, bytes(buffer))
    return Received(length, digest.hexdigest(), whole)
