"""Programs of others that read and write files of Gaussians, each as two functions; what they hold is compared here."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from engine.formats import encode_model, read_model
from engine.formats.spz.stream import write_spz
from engine.model import GaussianModel
from engine.numerics.similarity import quaternion_to_rotation
from tests.formats.gaussforge_child import gaussforge
from tests.formats.sog_scenes import pixels_of
from tests.formats.spz_scenes import as_version_4

PROGRAM = "splat-transform"
VIEWER = "PlayCanvas"
Files = dict[str, bytes]
"""By kind."""


@dataclass(frozen=True)
class Oracle:
    """A program; kinds are endings, with the version where there are several. It gets all files at once: starting it
    takes longer than what it does."""

    reads: tuple[str, ...]
    writes: tuple[str, ...]
    read: Callable[[Files], list[GaussianModel]]
    write: Callable[[GaussianModel, tuple[str, ...]], Files]
    spz_frame: Callable[[], str] = lambda: "ply"  # in which it takes every SPZ file to be
    sorts: bool = False  # what it reads, along a curve through space


@dataclass(frozen=True)
class Difference:
    """The largest over all Gaussians, in the units of the values; of shapes, relative to the covariance's norm."""

    centers: float
    sizes: float
    shapes: float
    opacities: float
    colors: float
    harmonics: float

    def __str__(self) -> str:
        return ", ".join(f"{name} {value:.1g}" for name, value in asdict(self).items())


def ours(model: GaussianModel, kind: str) -> bytes:
    """What this project writes."""
    if kind.startswith("spz"):
        return as_version_4(write_spz(model)) if kind == "spz4" else write_spz(model)
    return encode_model(model, kind)


def understood(data: bytes, oracle: Oracle) -> GaussianModel:
    """What this project reads, with the axes of SPZ as the program takes them."""
    return read_model(data, spz_frame=oracle.spz_frame()).model


def difference(a: GaussianModel, b: GaussianModel) -> Difference:
    """Row by row, harmonics up to the lower degree."""
    assert len(a) == len(b)
    least = min(a.sh.shape[1], b.sh.shape[1])
    shapes = _covariances(a)
    apart = np.linalg.norm(_covariances(b) - shapes, axis=(1, 2)) / np.linalg.norm(shapes, axis=(1, 2))

    def most(x: Any, y: Any) -> float:
        return float(np.abs(x - y).max(initial=0.0))

    return Difference(
        most(a.means, b.means),
        most(a.log_scales, b.log_scales),
        float(apart.max()),
        most(a.opacities, b.opacities),
        most(a.sh[:, 0], b.sh[:, 0]),
        most(a.sh[:, 1:least], b.sh[:, 1:least]),
    )


def in_order_of(model: GaussianModel, found: GaussianModel) -> GaussianModel:
    """The Gaussians of a file in the order that they had: some formats and programs sort them."""
    rows = cKDTree(found.means).query(model.means)[1]
    assert len(np.unique(rows)) == len(model)
    return found.take(rows)


def well_apart(model: GaussianModel, most: int) -> GaussianModel:
    """So many Gaussians at most, evenly through the file, each at a place of its own and in no corner of a range:
    programs treat an opacity of 0 or 1 in ways of their own."""
    few = model.take(np.flatnonzero(np.abs(model.opacity_logits) < 5))
    few = few.take(np.arange(0, len(few), -(-len(few) // most)))
    alone = cKDTree(few.means).query(few.means, k=2)[0][:, 1] > 1e-3 * np.median(few.scales)
    return few.take(np.flatnonzero(alone))


def compare(oracle: Oracle, model: GaussianModel) -> dict[tuple[str, str], Difference]:
    """What differs by direction and kind: "read" is our file as both read it, "written" its file as we read it, from
    the model, "read back" its file as both read it."""
    files = {kind: ours(model, kind) for kind in oracle.reads}
    found: dict[tuple[str, str], Difference] = {}
    for (kind, data), theirs in zip(files.items(), oracle.read(files), strict=True):
        mine = understood(data, oracle)
        found["read", kind] = difference(mine, in_order_of(mine, theirs) if oracle.sorts else theirs)
    written = oracle.write(model, oracle.writes)
    models = {kind: understood(data, oracle) for kind, data in written.items()}
    found |= {("written", kind): difference(model, in_order_of(model, each)) for kind, each in models.items()}
    readable = {kind: data for kind, data in written.items() if kind != "glb"}
    for kind, theirs in zip(readable, oracle.read(readable), strict=True):
        found["read back", kind] = difference(models[kind], theirs)
    return found


def _one_by_one(read: Callable[[bytes, str], GaussianModel]) -> Callable[[Files], list[GaussianModel]]:
    return lambda files: [read(data, kind) for kind, data in files.items()]


def _one_by_one_out(write: Callable[[GaussianModel, str], bytes]) -> Callable[[GaussianModel, tuple[str, ...]], Files]:
    return lambda model, kinds: {kind: write(model, kind) for kind in kinds}


def _covariances(model: GaussianModel) -> Any:
    turns = np.stack([quaternion_to_rotation(q / np.linalg.norm(q)) for q in model.quats.astype(np.float64)])
    axes = turns * np.exp(model.log_scales.astype(np.float64))[:, None]
    return axes @ axes.transpose(0, 2, 1)


def _read_gsply(data: bytes, kind: str) -> GaussianModel:
    from tests.formats.plain_gsply import gsply, sog_reader, spz

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scene." + kind.rstrip("234"))
        path.write_bytes(data)
        if kind == "sog":
            sog_reader._load_webp_image = _webp  # its own decoder is an extra
        read = sog_reader.sogread if kind == "sog" else spz.read_spz if kind.startswith("spz") else gsply.plyread
        found = read(data if kind == "sog" else path)
    rest = np.zeros((len(found.means), 0, 3)) if found.shN is None else found.shN
    sh = np.concatenate([found.sh0[:, None], rest.reshape(len(found.means), -1, 3)], axis=1)
    return GaussianModel(found.means, found.scales, found.quats, found.opacities, sh)


def _webp(data: bytes) -> tuple[Any, int, int]:
    pixels = pixels_of(data)
    return pixels.reshape(-1).astype(np.int64), pixels.shape[1], pixels.shape[0]  # numba calculates in 64 bits


def _write_gsply(model: GaussianModel, kind: str) -> bytes:
    from tests.formats.plain_gsply import gsply, spz

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scene." + kind.rstrip("234"))
        rest = model.sh[:, 1:] if model.sh_degree else None
        arrays = model.means, model.log_scales, model.quats, model.opacity_logits, model.sh[:, 0], rest
        if kind.startswith("spz"):
            spz.write_spz(path, gsply.GSData(*arrays), version=int(kind[3:]))
        else:
            gsply.plywrite(path, *arrays, compressed=kind == "compressed.ply")
        return path.read_bytes()


def _read_gaussforge(files: Files) -> list[GaussianModel]:
    """As PLY: its method `read` fails without harmonics."""
    calls = [{"data": data, "in_format": kind.rstrip("234"), "out_format": "ply"} for kind, data in files.items()]
    return [read_model(bytes(found)).model for found in gaussforge(*(("convert", call) for call in calls))]


def _write_gaussforge(model: GaussianModel, kinds: tuple[str, ...]) -> Files:
    calls: list[dict[str, Any]] = []
    for kind in kinds:
        calls.append({"data": ours(model, "ply"), "in_format": "ply", "out_format": kind.rstrip("234")})
        if kind.startswith("spz"):
            calls[-1]["spz_version"] = int(kind[3:])
    found = gaussforge(*(("convert", call) for call in calls))
    return {kind: bytes(data) for kind, data in zip(kinds, found, strict=True)}


def transform(source: Path, target: Path, *options: str) -> None:
    """Convert a file or a streamed scene by splat-transform."""
    command = [PROGRAM, "-q", "-w", "-g", "cpu", str(source), *options, str(target)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr or done.stdout


def _read_transform(data: bytes, kind: str) -> GaussianModel:
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "scene." + kind.rstrip("234")), Path(folder, "found.ply")
        source.write_bytes(data)
        transform(source, target)
        return read_model(target).model


def _write_transform(model: GaussianModel, kind: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "source.ply"), Path(folder, "scene." + kind.rstrip("234"))
        source.write_bytes(ours(model, "ply"))
        transform(source, target, *(("--spz-version", kind[3:]) if kind.startswith("spz") else ()))
        return target.read_bytes()


def _read_playcanvas(data: bytes, kind: str) -> GaussianModel:
    """By the engine of SuperSplat's viewer, which comes with splat-transform: activated scales and opacities, and the
    axes of glTF (y up), half a turn around z from those of PLY."""
    tool = shutil.which(PROGRAM)
    assert tool is not None
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, f"scene.{kind}"), Path(folder, "columns")
        source.write_bytes(data)
        command = ["node", str(Path(__file__).with_name("playcanvas_glb.mjs")), tool, str(source), str(target)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
        assert done.returncode == 0, done.stderr or done.stdout
        names = json.loads(done.stdout.splitlines()[-1])
        rows = dict(zip(names, np.frombuffer(target.read_bytes(), np.float32).reshape(len(names), -1), strict=True))

    def columns(name: str, count: int) -> Any:
        return np.stack([rows[f"{name}_{i}"] for i in range(count)], axis=1)

    count = sum(name.startswith("f_rest") for name in names) // 3
    sh = np.concatenate([columns("f_dc", 3)[:, None], np.zeros((len(rows["x"]), count, 3), np.float32)], axis=1)
    sh[:, 1:] = columns("f_rest", 3 * count).reshape(-1, 3, count).transpose(0, 2, 1) if count else 0
    orders = np.concatenate([np.arange(-degree, degree + 1) for degree in range(4)])[: 1 + count]
    w, x, y, z = columns("rot", 4).T
    opacity = rows["opacity"].astype(np.float64)
    return GaussianModel(
        np.stack([-rows["x"], -rows["y"], rows["z"]], axis=1),
        np.log(columns("scale", 3)),
        np.stack([-z, -y, x, w], axis=1),
        np.log(opacity / (1 - opacity)),
        sh * np.where(orders % 2, -1, 1)[:, None],
    )


@cache
def transform_frame() -> str:
    """Version 2 turns the axes as SPZ's specification wants it, version 3 leaves those of PLY."""
    said = subprocess.run([PROGRAM, "--version"], capture_output=True, text=True, timeout=60, check=True)
    found = re.search(r"v(\d+)\.", said.stdout + said.stderr)
    assert found is not None
    return "spec" if int(found[1]) < 3 else "ply"


ORACLES = {
    "gsply": Oracle(
        ("ply", "compressed.ply", "spz3", "spz4", "sog"),
        ("ply", "compressed.ply", "spz3", "spz4"),
        _one_by_one(_read_gsply),
        _one_by_one_out(_write_gsply),
    ),
    "GaussForge": Oracle(
        ("ply", "compressed.ply", "splat", "spz3", "spz4", "sog"),
        ("ply", "compressed.ply", "splat", "spz2", "spz3", "spz4", "sog"),
        _read_gaussforge,
        _write_gaussforge,
    ),
    PROGRAM: Oracle(
        ("ply", "compressed.ply", "splat", "spz3", "spz4", "sog"),
        ("ply", "compressed.ply", "spz3", "spz4", "sog", "glb"),
        _one_by_one(_read_transform),
        _one_by_one_out(_write_transform),
        transform_frame,
    ),
    VIEWER: Oracle(("glb",), (), _one_by_one(_read_playcanvas), lambda model, kinds: {}, sorts=True),
}
HERE = {
    name for name in ORACLES if name not in (PROGRAM, VIEWER) or (shutil.which(PROGRAM) and sys.platform != "win32")
}
