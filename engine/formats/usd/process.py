"""The process that opens an OpenUSD file: its path as the argument, the arrays of its Gaussians as an .npz on standard
output.

Pixar's library is native code that allocates what the numbers in a file say: so it gets a process with a limit of
memory, and damage that ends it ends nothing else.
"""

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, UnsupportedFormatError

SECONDS = 300
"""Of CPU time; a million Gaussians take two."""
MEMORY_BYTES, MEMORY_PER_BYTE = 2 << 30, 8
"""Of address space: the library itself, and so many times the file."""

SCHEMA = "ParticleField3DGaussianSplat"
SH, DEGREE = "radiance:sphericalHarmonicsCoefficients", "radiance:sphericalHarmonicsDegree"
OTHERS, SPACE = "others", "colorSpace:name"
FIELDS = {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1, SH: 3}
"""Attributes of a Gaussian: floats, or half floats under a name that ends in "h"; and the width of a row."""


def main() -> None:
    """Answer for one file, within limits on memory, time and files."""
    path = Path(sys.argv[1])
    _limit(path.stat().st_size)
    try:
        found: dict[str, npt.NDArray[Any]] = dict(_arrays(path))
    except FormatError as error:
        unsupported = isinstance(error, UnsupportedFormatError)
        said = {"message": error.message, "element": error.element, "prop": error.prop, "unsupported": unsupported}
        found = {"fault": np.array(json.dumps(said))}
    np.savez(sys.stdout.buffer, allow_pickle=False, **found)


def _limit(size: int) -> None:
    try:
        import resource
    except ImportError:  # Windows has no such limits
        return
    most, seconds = MEMORY_BYTES + MEMORY_PER_BYTE * size, math.ceil(SECONDS)
    for kind, limit in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_AS, most), (resource.RLIMIT_CPU, seconds)):
        ceiling = resource.getrlimit(kind)[1]
        limit = limit if ceiling == resource.RLIM_INFINITY else min(limit, ceiling)
        resource.setrlimit(kind, (limit, limit))


def _arrays(path: Path) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """Of each prim that is shown: its name, degree, matrix (4, 4) and attributes, under "NUMBER/FIELD"."""
    from pxr import Usd, UsdGeom

    try:
        if others := sorted(_outside(path)):
            message = f"refers to {len(others)} other files, first {others[0]!a:.60}: usdcat --flatten makes it one"
            raise UnsupportedFormatError(message)
        stage = Usd.Stage.Open(str(path))
        prims = list(stage.Traverse(Usd.TraverseInstanceProxies()))
        gaussians = [UsdGeom.Imageable(prim) for prim in prims if prim.GetTypeName() == SCHEMA]
        seen = [p for p in gaussians if p.ComputeVisibility() != UsdGeom.Tokens.invisible]
        shown = [p.GetPrim() for p in seen if p.ComputePurpose() not in ("guide", "proxy")]
        if not shown:
            nurec = path.suffix == ".usdz" and any(name.endswith(".nurec") for name in ZipFile(path).namelist())
            what = "it is a volume of NVIDIA's NuRec: export the scene as .ply (3DGRUT does)"
            what = what if nurec else f"no prim that is shown is a {SCHEMA}"
            raise UnsupportedFormatError(f"holds no Gaussians: {what}")
        yield OTHERS, np.array(list(_others(prims, shown)), dtype=np.str_)
        for number, prim in enumerate(shown):
            name = str(prim.GetPath())
            if any(UsdGeom.Xformable(p).TransformMightBeTimeVarying() for p in _upwards(prim) if UsdGeom.Xformable(p)):
                raise UnsupportedFormatError("moves with time: export one moment", element=name, prop="xformOp")
            space = str(prim.GetAttribute(SPACE).Get() or "")
            if space.startswith(("lin", "acescg", "g18", "g22")):
                message = f"colors are {space[:40]!a}, read are those of screens: export sRGB"
                raise UnsupportedFormatError(message, element=name, prop=SPACE)
            yield f"{number}/name", np.array(name)
            yield f"{number}/{DEGREE}", np.array(prim.GetAttribute(DEGREE).Get())
            matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
            yield f"{number}/matrix", np.array(matrix).T  # for columns
            for field, width in FIELDS.items():
                yield f"{number}/{field}", _values(prim, field, width, name)
    except (RuntimeError, ValueError, BadZipFile) as error:  # what the library says of damaged bytes
        reason = " ".join(_text(error).replace(str(path), "").split())[-120:]
        raise FormatError(f"cannot be read as OpenUSD ({reason!a})") from None


def _upwards(prim: Any) -> Iterator[Any]:
    """The prim, and those above it."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def _others(prims: list[Any], shown: list[Any]) -> Iterator[str]:
    """Paths of prims, and names of attributes of Gaussians, that are not read."""
    for prim in prims:
        if prim.GetTypeName() not in ("", "Xform", "Scope") and prim not in shown:
            yield str(prim.GetPath())
    known = {DEGREE, SPACE, "extent", "visibility", "purpose", "xformOpOrder", *FIELDS, *(f + "h" for f in FIELDS)}
    names = {each.GetName() for prim in shown for each in prim.GetAuthoredAttributes()}
    yield from sorted(name for name in names - known if not name.startswith("xformOp:"))


def _text(error: Exception) -> str:
    try:
        return str(error)
    except UnicodeDecodeError:  # it quotes the file
        return type(error).__name__


def _outside(path: Path) -> set[str]:
    """What the layers of a file name that does not lie in it: nothing else is opened."""
    from pxr import Sdf

    names = set(ZipFile(path).namelist()) if path.suffix == ".usdz" else set()
    waiting, seen, outside = [str(path)], set[str](), set[str]()
    while waiting:
        layer = Sdf.Layer.FindOrOpen(waiting.pop())
        for name in layer.GetCompositionAssetDependencies() if layer else ():
            inside = name.removeprefix("./")
            if name and inside not in names:  # an empty one is the layer itself
                outside.add(name)
            elif inside not in seen:
                seen.add(inside)
                waiting.append(f"{path}[{inside}]")
    return outside


def _values(prim: Any, field: str, width: int, name: str) -> npt.NDArray[np.float32]:
    """(N, width) values of an attribute, or of its twin in half floats."""
    for attribute in (prim.GetAttribute(field), prim.GetAttribute(field + "h")):
        times = attribute.GetTimeSamples()
        if len(times) > 1:
            message = "changes with time: a model that stands still would lose it; export one moment"
            raise UnsupportedFormatError(message, element=name, prop=field)
        found = attribute.Get(times[0]) if times else attribute.Get()
        if found is not None:
            with np.errstate(invalid="ignore"):  # signalling NaN
                return np.asarray(found, dtype=np.float32).reshape(-1, width)
    raise FormatError("is missing", element=name, prop=field)


if __name__ == "__main__":
    main()
