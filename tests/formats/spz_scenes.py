"""Models inside the ranges of SPZ, and SPZ files put together by hand, so that a test can make them lie."""

from __future__ import annotations

import gzip
import struct
import zlib

import numpy as np

from engine.formats import zstd
from engine.model import GaussianModel

STRIDES = {1: (6, 1, 3, 3, 3), 2: (9, 1, 3, 3, 3), 3: (9, 1, 3, 3, 4), 4: (9, 1, 3, 3, 4)}


def random_model(degree: int, n: int = 200, seed: int = 0) -> GaussianModel:
    """Values inside the ranges of SPZ."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return GaussianModel(
        rng.normal(0, 5, (n, 3)),
        rng.uniform(-9, 2, (n, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        rng.uniform(-4, 4, n),
        np.concatenate([rng.uniform(-3, 3, (n, 1, 3)), rng.uniform(-0.98, 0.98, (n, (degree + 1) ** 2 - 1, 3))], 1),
    )


def random_sections(version: int, degree: int, n: int, seed: int) -> list[bytes]:
    rng = np.random.default_rng(seed)
    return [rng.bytes(s * n) for s in (*STRIDES[version], 3 * ((degree + 1) ** 2 - 1))]


def head(version: int, n: int, degree: int, bits: int = 12, flags: int = 0) -> bytes:
    return struct.pack("<IIIBBBB", 0x5053474E, version, n, degree, bits, flags, 0)


def gzipped(version: int, n: int, degree: int, sections: list[bytes], tail: bytes = b"", flags: int = 0) -> bytes:
    return gzip.compress(head(version, n, degree, flags=flags) + b"".join(sections) + tail, 1)


def plain(version: int, n: int, degree: int, sections: list[bytes], tail: bytes = b"", flags: int = 0) -> bytes:
    return head(version, n, degree, flags=flags) + b"".join(sections) + tail


def as_version_4(data: bytes) -> bytes:
    """A file of version 3 in the container of version 4, which declares the specification's axes."""
    body = zlib.decompress(data, 31)
    magic, _, n, degree, bits, flags, _ = struct.unpack_from("<IIIBBBB", body)
    streams, at = [], 16
    for stride in (*STRIDES[3], 3 * ((degree + 1) ** 2 - 1)):
        streams += [body[at : at + stride * n]] if stride else []
        at += stride * n
    extension = frame_record(4)
    packed = [zstd.compress(each, 7) for each in streams]
    header = struct.pack("<IIIBBBBI12x", magic, 4, n, degree, bits, flags | 2, len(streams), 32 + len(extension))
    entries = [struct.pack("<QQ", len(a), len(b)) for a, b in zip(packed, streams, strict=True)]
    return b"".join([header, extension, *entries, *packed])


def record(kind: int, payload: bytes) -> bytes:
    return struct.pack("<II", kind, len(payload)) + payload


def frame_record(number: int) -> bytes:
    return record(0xADBE0003, struct.pack("<I", number))
