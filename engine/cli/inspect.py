"""`mark3dgs inspect`: what is in a model file."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console
from engine.cli.embed import size
from engine.cli.options import From, Json, SpzFrame
from engine.cli.streams import check_kind, input_file, input_name
from engine.cli.trust_options import read_certificates
from engine.numerics.plain import Json as Values
from engine.present.numerals import number

if TYPE_CHECKING:
    from engine.credentials.reading import Credentials
    from engine.scenes.scene_files import Loaded

DRAWN = {
    "default": "as Gaussians",
    "antialiased": "antialiased (Mip-Splatting's compensation)",
    "2dgs": "as discs (2DGS)",
}
"""How a model is to be drawn, in words."""

HOLDS = {
    "Trusted": "valid; you trust the signer",
    "Valid": "valid; the signer is not one that you trust",
    "Invalid": "INVALID: altered, or made for another file",
    "Unread": "could not be read",
}
"""The states of Content Credentials, in words."""


def inspect(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Model in any format that is read here; -: stdin.")],
    given: From = None,
    spz_frame: SpzFrame = "auto",
    trust: Annotated[
        Path | None, typer.Option("--trust", metavar="PEM", help="Certificates whose signers of credentials you trust.")
    ] = None,
    json: Json = False,
) -> int:
    """Describe a model file, and list what was mended, ignored or noticed on reading.

    Content Credentials (C2PA) in the file, or in its sidecar file (.c2pa), are
    shown, too, and what a glTF states of rights and provenance (XMP). They are
    statements: only 'mark3dgs verify' shows whether a mark is there.

    Example:

      mark3dgs inspect scene.ply
    """
    console = Console(json)
    began = time.perf_counter()
    anchors = "" if trust is None else _pem(trust)
    from engine.credentials.reading import read_credentials
    from engine.formats.gltf.metadata import read_metadata
    from engine.scenes.scene_files import read_scene

    with console.progress() as progress, input_file(model) as file:
        progress("read", 0.0)
        loaded = read_scene(file, name=input_name(model, given), spz_frame=spz_frame)
        check_kind(loaded.format, given, model)
        credentials = read_credentials(file, loaded.format, anchors)
        is_gltf = loaded.format == "glb" and file.is_file()
        metadata = read_metadata(file.read_bytes(), file=str(model)) if is_gltf else None
    report = describe_model(loaded) | {
        "file": str(model),
        "metadata": None if metadata is None else asdict(metadata),
        "credentials": None if credentials is None else credentials.to_json(),
        "seconds": time.perf_counter() - began,
    }
    low, high = report["bounds"]
    console.say(f"{model}: {report['format']}, {size(report['bytes'])}")
    console.say(f"  Gaussians   {report['gaussians']:,}, {report['bytes'] / report['gaussians']:.1f} bytes each")
    console.say(f"  color       spherical harmonics of degree {report['sh_degree']}")
    console.say(f"  rendered    {DRAWN[report['render_mode']]}")
    console.say(f"  kind        {'room, seen from inside' if report['is_room'] else 'object, seen from around'}")
    console.say(f"  center      {_vector(report['center'])}, radius {number(report['radius'], 4)}")
    console.say(f"  bounds      {_vector(low)} to {_vector(high)}")
    console.say(f"  opacity     median {report['opacity_median']:.3f}")
    console.say(f"  scale       median {number(report['scale_median'])}")
    console.say(f"  sha256      {report['sha256']}")
    noted = [repair["text"] for repair in report["repairs"]] or ["nothing to note"]
    console.say(*(f"  on reading  {text}" for text in noted))
    console.say(*(f"  {name:<12}{text}" for name, text in (report["metadata"] or {}).items() if text))
    if credentials is not None:
        _say_credentials(console, credentials)
    console.emit(report)
    return 0


def describe_model(loaded: Loaded) -> Values:
    """Facts about a loaded model, as plain values."""
    import numpy as np

    from engine.flows.views.camera_rig import measure_extent
    from engine.formats.modes import mode_of

    model = loaded.model
    extent, origin = measure_extent(model), np.array(model.origin)
    return {
        "format": loaded.format,
        "bytes": loaded.source_bytes,
        "sha256": loaded.sha256,
        "gaussians": len(model),
        "sh_degree": model.sh_degree,
        "render_mode": mode_of(model) or "default",
        "bounds": [(edge(model.means, axis=0) + origin).tolist() for edge in (np.min, np.max)],
        "center": (extent.center + origin).tolist(),
        "radius": extent.radius,
        "is_room": extent.is_room,
        "opacity_median": float(np.median(model.opacities)),
        "scale_median": float(np.exp(np.median(model.log_scales))),
        "repairs": [asdict(repair) for repair in loaded.noticed],
    }


def _say_credentials(console: Console, found: Credentials) -> None:
    why = found.reason or ", ".join(found.failures)
    console.say(f"  credentials {found.place}: {HOLDS[found.state]}{f' ({why})' if why else ''}")
    if found.state not in ("Trusted", "Valid"):  # what it says may not come from the signer it names
        return
    when = f", {found.signed_at}" if found.signed_at else ", at a time without attestation"
    console.say(f"  signed by   {found.signer} ({found.issuer}), {found.algorithm}{when}")
    console.say(f"  says        {found.generator}: {', '.join(found.actions)}")
    console.say(*(f"  bound to    {alg} {value}" for alg, value in found.bindings))
    console.say(*(f"              which is the record {record}" for record in found.record_ids))


def _pem(path: Path) -> str:
    """Certificates as text, checked to be some."""
    from cryptography.hazmat.primitives.serialization import Encoding

    return "".join(each.public_bytes(Encoding.PEM).decode() for each in read_certificates(path))


def _vector(values: list[float]) -> str:
    return "(" + ", ".join(number(value, 4) for value in values) + ")"
