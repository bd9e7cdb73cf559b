"""Uploads against a model of their protocol: one offset, moved by compare and set, whatever clients do at a time.

MARK3DGS_UPLOAD_STEPS sets how many steps are played (400): `MARK3DGS_UPLOAD_STEPS=10000 pytest -m '' ...` for many.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import tempfile
from dataclasses import dataclass, field, replace
from itertools import chain, permutations
from pathlib import Path
from typing import Any
from unittest.mock import patch

import obstore
import pytest
import sqlalchemy as sa
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, initialize, multiple, rule
from starlette.types import Message

from service.app import make_app
from service.core import Service
from service.db.schema import uploads
from service.settings import Settings
from service.trust.api_keys import issue
from service.uploads import ingest, store

STEPS, AT_A_TIME = int(os.environ.get("MARK3DGS_UPLOAD_STEPS", "400")), 40
PIECES = st.lists(st.binary(max_size=9), max_size=4)


@dataclass(frozen=True)
class Slot:
    """What the model knows of an upload."""

    size: int | None
    sha256: str | None
    data: bytes = b""
    complete: bool = False


@dataclass
class Sending:
    """A request in flight: its pieces, and how many of them were sent."""

    slot: str
    start: int
    room: int | None
    pieces: list[bytes]
    sent: bytes = b""
    messages: asyncio.Queue[Message] = field(default_factory=asyncio.Queue)
    waits: asyncio.Event = field(default_factory=asyncio.Event)
    status: int = 0

    async def receive(self) -> Message:
        if self.messages.empty():
            self.waits.set()
        return await self.messages.get()

    async def send(self, message: Message) -> None:
        self.status = message.get("status", self.status)

    def give(self, message: Message) -> None:
        self.waits.clear()
        self.sent += message.get("body", b"")
        self.messages.put_nowait(message)


def come_to(slot: Slot | None, sending: Sending, cut: bool) -> tuple[int, Slot | None]:
    """The status that a request ends with, and what becomes of its slot."""
    total = len(sending.sent)
    if sending.room is not None and total > sending.room:
        return 413, slot
    if total == 0:
        return (200 if cut else 422), slot
    if sending.room is None and cut:
        return 200, slot
    if slot is None:
        return 404, None
    if slot.complete or len(slot.data) != sending.start:
        return 409, slot
    data = slot.data + sending.sent
    if total != sending.room and slot.size is not None:
        return 200, replace(slot, data=data)
    if slot.sha256 not in (None, hashlib.sha256(data).hexdigest()):
        return 422, None
    return 200, replace(slot, data=data, complete=True)


class Services:
    """The application with files in a folder, and in an object store; made once."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.made: dict[str, Any] = {}
        self.machines = self.steps = 0

    def app(self, blob_url: str) -> Any:
        if blob_url not in self.made:
            folder = Path(tempfile.mkdtemp())
            service = Service.open(Settings(data_dir=folder, blob_url=blob_url, open_uploads=1 << 20))
            self.made[blob_url] = make_app(service)
        return self.made[blob_url]


SERVICES = Services()


class Protocol(RuleBasedStateMachine):
    """Clients that create, send, break off, send again, overlap and delete."""

    slots = Bundle("slots")
    sendings = Bundle("sendings")

    @initialize(blob_url=st.sampled_from(["", "memory:///"]))
    def begin(self, blob_url: str) -> None:
        self.app = SERVICES.app(blob_url)
        self.service: Service = self.app.state.service
        SERVICES.machines += 1
        self.tenant = f"machine {SERVICES.machines}"
        token = issue(self.service.db, self.service.master, self.tenant, ["embed"])
        self.headers = [(b"authorization", f"Bearer {token}".encode()), (b"host", b"t")]
        self.model: dict[str, Slot | None] = {}
        self.tasks: dict[int, asyncio.Task[None]] = {}

    def run(self, awaitable: Any) -> Any:
        return SERVICES.loop.run_until_complete(awaitable)

    async def ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int, Any]:
        got: list[Message] = []
        sent = iter([{"type": "http.request", "body": body or b"", "more_body": False}])

        async def receive() -> Message:
            return next(sent, {"type": "http.disconnect"})

        async def send(message: Message) -> None:
            got.append(message)

        await self.app(self.scope(method, path, ("content-type", "application/json")), receive, send)
        text = b"".join(message.get("body", b"") for message in got)
        return got[0]["status"], json.loads(text) if text else None

    def scope(self, method: str, path: str, *headers: tuple[str, str]) -> dict[str, Any]:
        more = [(name.encode(), value.encode()) for name, value in headers]
        plain = {"type": "http", "method": method, "path": path, "raw_path": path.encode(), "query_string": b""}
        return plain | {"headers": [*self.headers, *more], "scheme": "http", "http_version": "1.1", "root_path": ""}

    async def settle(self, sending: Sending) -> None:
        """Until the application waits for the client, or has answered."""
        waits = asyncio.create_task(sending.waits.wait())
        await asyncio.wait([waits, self.tasks[id(sending)]], return_when=asyncio.FIRST_COMPLETED)
        waits.cancel()

    def check(self, name: str) -> None:
        """What the service says and holds of an upload is what the model says."""
        SERVICES.steps += 1
        status, plain = self.run(self.ask("GET", f"/v1/uploads/{name}"))
        slot = self.model[name]
        if slot is None:
            assert status == 404
            return
        state = "complete" if slot.complete else "open"
        assert (status, plain["offset"], plain["state"]) == (200, len(slot.data), state)
        if slot.complete:
            assert plain["sha256"] == hashlib.sha256(slot.data).hexdigest()
            assert self.service.blobs.read(plain["sha256"]) == slot.data

    @rule(target=slots, size=st.integers(1, 30) | st.none(), digest=st.sampled_from(["none", "wrong"]))
    def create(self, size: int | None, digest: str) -> str:
        sha256 = None if digest == "none" else "0" * 64
        body = json.dumps({"size": size, "sha256": sha256}).encode()
        status, plain = self.run(self.ask("POST", "/v1/uploads", body))
        assert status == 201
        self.model[plain["id"]] = Slot(size, sha256)
        self.check(plain["id"])
        return str(plain["id"])

    @rule(target=slots, data=st.binary(min_size=1, max_size=30), cuts=st.lists(st.integers(0, 30), max_size=3))
    def create_and_send(self, data: bytes, cuts: list[int]) -> str:
        """A client that does everything right, with the digest announced."""
        body = json.dumps({"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}).encode()
        name = str(self.run(self.ask("POST", "/v1/uploads", body))[1]["id"])
        self.model[name] = Slot(len(data), hashlib.sha256(data).hexdigest())
        ends = sorted({*(cut for cut in cuts if 0 < cut < len(data)), len(data)})
        for low, high in zip([0, *ends], ends, strict=False):
            for sending in self._start(name, low, [data[low:high]]):
                self._end(sending, cut=False)
        slot = self.model[name]
        assert slot is not None
        assert slot.complete
        return name

    @rule(
        target=sendings, name=slots, where=st.sampled_from(["right", "right", "right", "zero", "next"]), pieces=PIECES
    )
    def start(self, name: str, where: str, pieces: list[bytes]) -> Any:
        slot = self.model[name]
        offset = len(slot.data) if slot else 0
        return multiple(*self._start(name, {"right": offset, "zero": 0, "next": offset + 1}[where], pieces))

    def _start(self, name: str, start: int, pieces: list[bytes]) -> list[Sending]:
        """Of a request that was not refused at once."""
        slot = self.model[name]
        room = None if slot is None or slot.size is None else slot.size - len(slot.data)
        sending = Sending(name, start, room, pieces)
        scope = self.scope("PUT", f"/v1/uploads/{name}", ("upload-offset", str(start)))
        task = SERVICES.loop.create_task(self.app(scope, sending.receive, sending.send))
        self.tasks[id(sending)] = task
        self.run(self.settle(sending))
        if slot is None or slot.complete or len(slot.data) != start:
            assert task.done()
            assert sending.status == (404 if slot is None else 409)
            self.check(name)
            return []
        assert not task.done()
        return [sending]

    @rule(sending=sendings)
    def feed(self, sending: Sending) -> None:
        """One piece more."""
        if sending.pieces and not self.tasks[id(sending)].done():
            sending.give({"type": "http.request", "body": sending.pieces.pop(0), "more_body": True})
            self.run(self.settle(sending))
            if self.tasks[id(sending)].done():
                assert sending.status == 413
            self.check(sending.slot)

    @rule(sending=consumes(sendings), cut=st.booleans())
    def end(self, sending: Sending, cut: bool) -> None:
        """The rest comes, or the line breaks."""
        self._end(sending, cut)

    def _end(self, sending: Sending, cut: bool) -> None:
        self._last_words(sending, cut)
        self.run(self.tasks.pop(id(sending)))
        status, self.model[sending.slot] = come_to(self.model[sending.slot], sending, cut)
        assert sending.status == status
        self.check(sending.slot)

    def _last_words(self, sending: Sending, cut: bool) -> None:
        if not self.tasks[id(sending)].done():
            gone: Message = {"type": "http.disconnect"}
            rest: Message = {"type": "http.request", "body": b"".join(sending.pieces), "more_body": False}
            sending.give(gone if cut else rest)

    @rule(name=slots, pieces=st.lists(st.binary(min_size=1, max_size=30), min_size=2, max_size=3), cut=st.booleans())
    def race(self, name: str, pieces: list[bytes], cut: bool) -> None:
        """Several requests begin at the present offset and end in one moment; they came in some order."""
        slot = self.model[name]
        begun = [self._start(name, len(slot.data) if slot else 0, [piece]) for piece in pieces]
        ran = list(chain.from_iterable(begun))
        for sending in ran if cut else ():
            self.feed(sending)
        for sending in ran:
            self._last_words(sending, cut)
        if ran:
            self.run(asyncio.wait([self.tasks.pop(id(sending)) for sending in ran]))
        got = [sending.status for sending in ran]
        status, plain = self.run(self.ask("GET", f"/v1/uploads/{name}"))
        seen = (plain["offset"], plain["state"] == "complete") if status == 200 else None
        for order in permutations(range(len(ran))):
            now, statuses = slot, [0] * len(ran)
            for number in order:
                statuses[number], now = come_to(now, ran[number], cut)
            if statuses == got and seen == (now and (len(now.data), now.complete)):
                self.model[name] = now
                break
        else:
            raise AssertionError(f"no order of the requests answers {got} and leaves {seen}")
        self.check(name)

    @rule(name=slots)
    def delete(self, name: str) -> None:
        status, _ = self.run(self.ask("DELETE", f"/v1/uploads/{name}"))
        assert status == (404 if self.model[name] is None else 204)
        self.model[name] = None
        self.check(name)

    def teardown(self) -> None:
        """Requests that still ran break off; then no file is left but the parts that rows name."""
        if not hasattr(self, "app"):
            return
        for task in self.tasks.values():
            task.cancel()
        if self.tasks:
            self.run(asyncio.wait(self.tasks.values()))
        mine = sa.select(uploads.c.parts).where((uploads.c.tenant == self.tenant) & (uploads.c.state == "open"))
        named = set(chain.from_iterable(map(store.part_names, self.service.db.query(mine).scalars())))
        stored = chain.from_iterable(obstore.list(self.service.blobs.store, store.PARTS))
        assert {str(each["path"]) for each in stored if str(each["path"]).split("/")[1] in self.model} == named


Protocol.TestCase.settings = settings(
    max_examples=max(1, STEPS // AT_A_TIME),
    stateful_step_count=AT_A_TIME,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # a story is short enough, and made shorter for minutes
)


@pytest.mark.timeout(3600)
class TestProtocol(Protocol.TestCase):  # type: ignore[misc, name-defined]
    """The machine, with small batches and without looking into the files."""

    def runTest(self) -> None:
        known = {"format": "ply", "gaussians": 1, "cameras": 1}
        with patch.object(ingest, "BATCH", 8), patch.object(ingest, "run_once", lambda *_: known):
            super().runTest()
