"""Small models and hand-made PLY files for the tests of the formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.model import GaussianModel

DATA = Path(__file__).parents[1] / "data"
ATTRIBUTES = ("means", "log_scales", "quats", "opacity_logits", "sh")


def random_model(degree: int = 3, n: int = 600, seed: int = 0) -> GaussianModel:
    """A cloud with unit quaternions and moderate values, n no multiple of 256."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return GaussianModel(
        rng.normal(size=(n, 3)),
        rng.normal(-4, 1, (n, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        rng.normal(0, 2, n).clip(-5, 5),  # alpha of 1..254 in eight bits
        rng.normal(0, 0.3, (n, (degree + 1) ** 2, 3)),
    )


def assert_same(a: GaussianModel, b: GaussianModel) -> None:
    """Bit for bit."""
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def names_of(degree: int = 0, scales: int = 3, normals: bool = False) -> list[str]:
    """INRIA's properties."""
    names = ["x", "y", "z", *(["nx", "ny", "nz"] if normals else []), "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(3 * ((degree + 1) ** 2 - 1))]
    return [*names, "opacity", *(f"scale_{i}" for i in range(scales)), *(f"rot_{i}" for i in range(4))]


def rows_for(names: list[str], n: int, seed: int = 0) -> npt.NDArray[np.float32]:
    """(n, len(names)) moderate values."""
    return np.random.default_rng(seed).normal(size=(n, len(names))).astype(np.float32)


def header_for(
    names: list[str], n: int, encoding: str = "binary_little_endian", kind: str = "float", count: str | None = None
) -> bytes:
    """Header of a file with one element; `count` lies about n."""
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {count or n}"]
    return "\n".join([*lines, *(f"property {kind} {name}" for name in names), "end_header", ""]).encode()


def ply_of(names: list[str], rows: npt.NDArray[np.float32], count: str | None = None) -> bytes:
    """A whole little-endian file of float32."""
    return header_for(names, len(rows), count=count) + rows.astype("<f4").tobytes()
