"""SOG scenes put together part by part, so that a test can make any one of them lie."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from typing import Any

import numpy as np
from PIL import Image

from engine.model import GaussianModel


def webp(pixels: np.ndarray, lossless: bool = True) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "WEBP", lossless=lossless, exact=True, method=0, quality=0)
    return buffer.getvalue()


def png(pixels: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


def zip64(data: bytes) -> bytes:
    """An archive whose end says everything in the 64-bit record, as tools that stream write it (APPNOTE 4.3.14)."""
    directory, end = data[:-22], data[-22:]
    entries, size, offset = struct.unpack_from("<HII", end, 10)
    record = struct.pack("<4sQHHIIQQQQ", b"PK\6\6", 44, 45, 45, 0, 0, entries, entries, size, offset)
    locator = struct.pack("<4sIQI", b"PK\6\7", 0, len(directory), 1)
    return directory + record + locator + b"PK\5\6" + bytes(4) + b"\xff" * 12 + bytes(2)


def bundle(parts: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return buffer.getvalue()


def unbundle(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pixels_of(part: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(part)).convert("RGBA"))


def with_meta(data: bytes, **members: Any) -> bytes:
    """A bundle whose meta.json has other members; "means.files" reaches into a member, None removes it."""
    parts = unbundle(data)
    meta = json.loads(parts["meta.json"])
    for path, value in members.items():
        *outer, last = path.split(".")
        target = meta
        for key in outer:
            target = target[key]
        if value is None:
            del target[last]
        else:
            target[last] = value
    return bundle({**parts, "meta.json": json.dumps(meta).encode()})


def with_parts(data: bytes, **parts: bytes | None) -> bytes:
    """A bundle with other parts; None removes one. Names without their ending."""
    all_parts = unbundle(data)
    for name, part in parts.items():
        if part is None:
            del all_parts[f"{name}.webp"]
        else:
            all_parts[f"{name}.webp"] = part
    return bundle(all_parts)


def version_1(n: int, degree: int, seed: int = 0) -> tuple[bytes, dict[str, np.ndarray]]:
    """A bundle of version 1, and its attributes computed Gaussian by Gaussian from the definition."""
    rng = np.random.default_rng(seed)
    width, height = 16, -(-n // 16)
    rest = {0: 0, 1: 3, 2: 8, 3: 15}[degree]

    def image(channels: int) -> np.ndarray:
        return rng.integers(0, 256, (height, width, channels), dtype=np.uint8)

    low, high, scales, quats, sh0 = image(3), image(3), image(3), image(4), image(4)
    quats[..., :3] = 64 + quats[..., :3] // 2  # no component larger than the one left out
    quats[..., 3] = rng.integers(252, 256, (height, width))
    low_high = {"mins": [-1.5, -0.5, -2.0], "maxs": [1.0, 2.5, 0.5]}
    scale_range = {"mins": [-8.0, -7.0, -9.0], "maxs": [-1.0, -2.0, -3.0]}
    color_range = {"mins": [-2.0, -1.0, -1.5, -5.0], "maxs": [2.0, 1.5, 1.0, 6.0]}
    parts = {"means_l": low, "means_u": high, "scales": scales, "quats": quats, "sh0": sh0}
    meta: dict[str, Any] = {
        "means": {"shape": [n, 3], "dtype": "float32", "files": ["means_l.webp", "means_u.webp"], **low_high},
        "scales": {"shape": [n, 3], "dtype": "float32", "files": ["scales.webp"], **scale_range},
        "quats": {"shape": [n, 4], "dtype": "uint8", "encoding": "quaternion_packed", "files": ["quats.webp"]},
        "sh0": {"shape": [n, 1, 4], "dtype": "float32", "files": ["sh0.webp"], **color_range},
    }
    if degree:
        centroids = rng.integers(0, 256, (2, 64 * rest, 3), dtype=np.uint8)
        labels = np.zeros((height, width, 3), dtype=np.uint8)
        labels[..., 0] = rng.integers(0, 128, (height, width))
        parts |= {"shN_centroids": centroids, "shN_labels": labels}
        meta["shN"] = {
            "shape": [n, rest * 3],
            "dtype": "float32",
            "mins": -0.75,
            "maxs": 0.5,
            "quantization": 8,
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
    expected: dict[str, list[Any]] = {"means": [], "log_scales": [], "quats": [], "opacity_logits": [], "sh": []}
    for i in range(n):
        at = divmod(i, width)
        bent = [
            a + (b - a) * (int(low[at][c]) + 256 * int(high[at][c])) / 65535
            for c, (a, b) in enumerate(zip(low_high["mins"], low_high["maxs"], strict=True))
        ]
        expected["means"].append([np.sign(v) * (np.exp(abs(v)) - 1) for v in bent])
        expected["log_scales"].append(
            [a + (b - a) * int(scales[at][c]) / 255 for c, (a, b) in enumerate(zip(*scale_range.values(), strict=True))]
        )
        color = [
            a + (b - a) * int(sh0[at][c]) / 255 for c, (a, b) in enumerate(zip(*color_range.values(), strict=True))
        ]
        expected["opacity_logits"].append(color[3])
        largest = int(quats[at][3]) - 252
        small = [(int(p) / 255 * 2 - 1) / np.sqrt(2) for p in quats[at][:3]]
        quat = [*small[:largest], np.sqrt(max(0.0, 1 - sum(s * s for s in small))), *small[largest:]]
        expected["quats"].append(np.array(quat) / np.linalg.norm(quat))
        sh = [color[:3]]
        if degree:
            row, column = divmod(int(labels[at][0]), 64)
            code = centroids[row, column * rest : (column + 1) * rest].astype(float)
            sh += (-0.75 + 1.25 * code / 255).tolist()
        expected["sh"].append(sh)
    files = {f"{name}.webp": webp(pixels) for name, pixels in parts.items()}
    arrays = {name: np.array(values) for name, values in expected.items()}
    return bundle({"meta.json": json.dumps(meta).encode(), **files}), arrays


def random_model(degree: int, n: int = 300, seed: int = 0) -> GaussianModel:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return GaussianModel(
        rng.normal(0, 5, (n, 3)),
        rng.normal(-4, 1.5, (n, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        rng.uniform(-5, 5, n),
        rng.normal(0, 0.3, (n, (degree + 1) ** 2, 3)),
    )
