"""Hostile files: refused with a 4xx within five seconds, in bounded memory, and the service goes on."""

from __future__ import annotations

import gzip
import os
import struct
import time
import zipfile
from functools import partial

import pytest

from tests.formats.sog_scenes import bundle
from tests.service.api.conftest import Api

HEADER = b"ply\nformat binary_little_endian 1.0\n"
XYZ = b"property float x\nproperty float y\nproperty float z\n"


_zip = partial(bundle, compression=zipfile.ZIP_DEFLATED)
SPZ_BOMB = gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, 10, 3, 12, 0, 0) + bytes(200 << 20), 1)
CASES = {
    "empty ply": b"ply\n",
    "a count of a trillion": HEADER + b"element vertex 1000000000000\n" + XYZ + b"end_header\n",
    "a count that lies": HEADER + b"element vertex 100000\n" + XYZ + b"end_header\n" + bytes(12),
    "a negative count": HEADER + b"element vertex -1\n" + XYZ + b"end_header\n",
    "10,000 properties": HEADER + b"element vertex 1\n" + b"".join(b"property float p%d\n" % i for i in range(10_000)),
    "a header without end": HEADER + b"comment " + b"x" * (4 << 20),
    "list properties": HEADER + b"element vertex 1\nproperty list uchar int x\nend_header\n" + bytes(64),
    "gzip bomb": SPZ_BOMB,
    "spz of 4 billion": gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, 0xFFFFFFFF, 3, 12, 0, 0)),
    "zip bomb": _zip({"meta.json": b"[" * (64 << 20)}),
    "zip with path names": _zip({"../../etc/passwd": b"x", "meta.json": b"{}"}),
    "zip of ten thousand files": _zip({f"{i}.webp": b"" for i in range(10_000)}),
    "meta that is no JSON": _zip({"meta.json": b"{" * 100_000}),
    "random": bytes(range(256)) * 4000 + b"x",
    "a splat cut short": bytes(32 * 100 + 7),
    "truncated zip": _zip({"meta.json": b"{}"})[:-10],
    "a png bomb": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
    + struct.pack(">II", 100_000, 100_000)
    + b"\x08\x02\0\0\0"
    + bytes(64),
    "a jpeg cut short": b"\xff\xd8\xff\xe0\0\x10JFIF\0" + bytes(20),
    "json that nests": b"[" * 100_000,
    "a text": b"Hello, I am a model.",
}


@pytest.mark.parametrize("name", CASES)
def test_refused_in_time(api: Api, name: str) -> None:
    data = CASES[name]
    began = time.perf_counter()
    slot = api.client.post("/v1/uploads", json={"name": "../../../etc/passwd", "size": len(data)}).json()["id"]
    answer = api.client.put(f"/v1/uploads/{slot}", content=data)
    seconds = time.perf_counter() - began
    assert 400 <= answer.status_code < 500, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert str(api.service.settings.data_dir) not in answer.text
    assert seconds < 5.0 or os.getloadavg()[0] > 2 * (os.cpu_count() or 1), "late, on a machine with nothing else to do"
    assert api.client.get("/healthz").status_code == 200
    assert api.client.get(f"/v1/uploads/{slot}").status_code == 404
