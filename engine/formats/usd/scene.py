"""Gaussians in OpenUSD: prims of the schema ParticleField3DGaussianSplat, read and written through Pixar's `usd-core`.

Specification: UsdVol of OpenUSD 26.03: linear sizes and opacities, quaternions, and (degree + 1)^2 coefficients a
Gaussian, in INRIA's order and signs; each of floats, or of half floats under a name that ends in "h". Positions stand
in the prim's own space as they do in a PLY, which is how NVIDIA's converter writes them; transforms above it are
applied.
"""

import io
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.extras import load_extra
from engine.formats.gltf.nodes import placed
from engine.formats.guards import check_count
from engine.formats.ply.extras import named
from engine.formats.repairs import Repair, clean, degree_dropped
from engine.formats.usd.process import DEGREE, FIELDS, OTHERS, SECONDS, SH
from engine.model import GaussianModel

_PARTS = ("name", DEGREE, "matrix", *FIELDS)
_COMMAND = (sys.executable, "-P", "-m", "engine.formats.usd.process")
"""-P: the folder that one stands in may be anybody's, too; no module is taken from there."""


def kind_of_usd(data: bytes) -> str | None:
    """Whether the first bytes are those of a scene as text ("usda"), in binary ("usdc") or in an archive ("usdz")."""
    if data.startswith((b"PXR-USDC", b"#usda")):
        return "usdc" if data.startswith(b"PXR") else "usda"
    length = int.from_bytes(data[26:28], "little")  # of the name of an archive's first file, which is the scene
    first = data[30 : 30 + length].lower() if data.startswith(b"PK\3\4") else b""
    return "usdz" if first.endswith((b".usd", b".usda", b".usdc")) else None


def load_usd(purpose: str) -> Any:
    """The package `pxr`, of the extra `usd`; InputError where it is not installed."""
    pxr = load_extra("pxr", "usd", purpose)
    for module in ("Usd", "UsdGeom", "UsdUtils", "UsdVol", "Vt"):
        load_extra(f"pxr.{module}", "usd", purpose)
    return pxr


def read_usd(data: bytes, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """All Gaussians that a scene shows, prim after prim.

    UnsupportedFormatError if there are none, if they move or are stretched, if the scene refers to other files, or if
    the extra `usd` is not installed; FormatError if it cannot be read, or an attribute has another length.
    """
    try:
        load_usd("is an OpenUSD scene, and reading it")
    except InputError as error:
        raise UnsupportedFormatError(str(error), file=file) from None
    found = _opened(data, file)
    others = found.pop(OTHERS).tolist()
    text = f"what is no Gaussian of the scene was ignored: {named(others)}"
    repairs = [Repair("extra_usd", len(others), text)] if others else []
    prims = ({key: found[f"{k}/{key}"] for key in _PARTS} for k in range(len({key.partition("/")[0] for key in found})))
    model, mended = placed(((*_read_prim(prim, len(data), file), prim["matrix"]) for prim in prims), file=file)
    return model, (*repairs, *mended)


def write_usd(model: GaussianModel, kind: str) -> bytes:
    """The scene as "usda", "usdc" or "usdz", one prim, float32: only sizes and opacities are rounded, by the
    exponential and the logistic function. InputError where the extra `usd` is not installed."""
    pxr = load_usd(f"writing .{kind}")
    stage = pxr.Usd.Stage.CreateInMemory(f"scene.{'usdc' if kind == 'usdz' else kind}")
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.y)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = pxr.UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Splats")
    stage.SetDefaultPrim(prim.GetPrim())
    three, four, one = pxr.Vt.Vec3fArray.FromNumpy, pxr.Vt.QuatfArray.FromNumpy, pxr.Vt.FloatArray.FromNumpy
    prim.CreatePositionsAttr(three(model.means))
    prim.CreateOrientationsAttr(four(np.ascontiguousarray(model.quats[:, [1, 2, 3, 0]])))
    prim.CreateScalesAttr(three(model.scales))
    prim.CreateOpacitiesAttr(one(model.opacities))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(model.sh_degree)
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(three(model.sh.reshape(-1, 3)))
    reach = 3.0 * model.scales.max(axis=1, keepdims=True)  # of a Gaussian, as its box: USD culls by it
    box = np.stack([(model.means - reach).min(axis=0), (model.means + reach).max(axis=0)])
    prim.CreateExtentAttr(three(box.astype(np.float32)))
    with tempfile.TemporaryDirectory() as folder:
        scene, packed = Path(folder) / f"scene.{'usdc' if kind == 'usdz' else kind}", Path(folder) / "scene.usdz"
        stage.GetRootLayer().Export(str(scene))
        if kind == "usdz":
            pxr.UsdUtils.CreateNewUsdzPackage(str(scene), str(packed))
        return (packed if kind == "usdz" else scene).read_bytes()


def _opened(data: bytes, file: str) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a scene, as `process` finds them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"scene.{kind_of_usd(data)}"
        path.write_bytes(data)
        env = {**os.environ, "PXR_WORK_THREAD_LIMIT": "1"}
        try:
            done = subprocess.run(
                [*_COMMAND, str(path)], capture_output=True, check=False, env=env, timeout=2 * SECONDS
            )
        except subprocess.TimeoutExpired:
            raise FormatError(f"cannot be read as OpenUSD within {2 * SECONDS} s", file=file) from None
    if done.returncode:
        message = f"cannot be read as OpenUSD: the library ended with {done.returncode}, for its memory or by a fault"
        raise FormatError(message, file=file)
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as found:
        if "fault" not in found:
            return dict(found)
        fault = json.loads(str(found["fault"]))
    kind = UnsupportedFormatError if fault.pop("unsupported") else FormatError
    raise kind(**fault, file=file)


def _read_prim(found: Mapping[str, npt.NDArray[Any]], size: int, file: str) -> tuple[GaussianModel, list[Repair]]:
    name, count = str(found["name"]), len(found["positions"])
    check_count(count, size, file=file)
    for key in ("orientations", "scales", "opacities"):
        if len(found[key]) != count:
            message = f"has {len(found[key])} rows, positions {count}"
            raise FormatError(message, file=file, element=name, prop=key)
    degree = int(found[DEGREE]) if found[DEGREE].dtype.kind == "i" else -1
    if not 0 <= degree <= 4:
        raise UnsupportedFormatError(f"is {found[DEGREE]!s:.20}, read is 0 to 4", file=file, element=name, prop=DEGREE)
    whole = (degree + 1) ** 2
    if len(found[SH]) != count * whole:
        message = f"has {len(found[SH])} coefficients for {count} Gaussians of degree {degree}"
        raise FormatError(message, file=file, element=name, prop=SH)
    sh = found[SH].reshape(count, whole, 3)[:, : min(whole, 16)]
    opacities = found["opacities"][:, 0].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):  # 0 and 1 are mended, what lies outside is a fault
        log_scales = np.log(found["scales"])
        logits = np.log(opacities) - np.log1p(-opacities)
    quats = found["orientations"][:, [3, 0, 1, 2]]
    model, mended = clean(found["positions"], log_scales, quats, logits, sh, file=file, element=name)
    return model, [*((degree_dropped(degree, count),) if degree > 3 else ()), *mended]
