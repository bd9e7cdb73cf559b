"""`mark3dgs convert`: a model in another format, with a note on what that cannot hold."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console, Progress
from engine.cli.options import From, Json, SpzFrame
from engine.cli.streams import STREAM, check_kind, check_stdout, input_file, input_name, write_stdout
from engine.errors import InputError
from engine.usecases.files import check_folder, check_target, format_for, refuse_same, whole_file, whole_folder

if TYPE_CHECKING:
    from engine.formats.gltf.metadata import Metadata
    from engine.model import GaussianModel
    from engine.scenes.scene_files import Scene

STREAMED = "lod-meta.json"
KEPT = 0.25
"""Share of its Gaussians that each level of detail has of the one before it."""


def convert(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Model in any format that is read here; -: stdin.")],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="File to write; its ending names the format. NEW_FOLDER/lod-meta.json: streamed SOG. -: stdout.",
        ),
    ],
    given: From = None,
    to: Annotated[
        str | None, typer.Option("--to", metavar="FORMAT", help="Format to write, where the name does not say it.")
    ] = None,
    levels: Annotated[
        int, typer.Option("--levels", metavar="N", min=1, max=8, help="Levels of detail of streamed SOG.")
    ] = 1,
    rights: Annotated[
        str, typer.Option("--rights", metavar="TEXT", help="Statement of rights that a .glb carries (XMP, dc:rights).")
    ] = "",
    provenance: Annotated[
        str, typer.Option("--provenance", metavar="URL", help="Address of its Content Credentials, for a .glb to name.")
    ] = "",
    spz_frame: SpzFrame = "auto",
    json: Json = False,
) -> int:
    """Write a model in another format.

    A mark stays in what is converted. Each further level of detail is merged
    from the one before it, as publishing tools do, to a quarter of its
    Gaussians. A clip that moves stays a clip: only .ply holds it. What a .glb
    says of rights and provenance is a statement, which 'mark3dgs inspect' shows.
    Properties and comments of a .ply that are no Gaussian's stay in a .ply.

    Examples:

      mark3dgs convert scene.ksplat scene.ply
      mark3dgs convert scene.ply scene.glb --rights "(c) 2026 Studio Acme"
      mark3dgs convert scene.ply published/lod-meta.json --levels 3
      curl -s https://example.org/scene.spz | mark3dgs convert - - --to ply > scene.ply
    """
    console = Console(json)
    began = time.perf_counter()
    streamed = out.name == STREAMED
    if levels > 1 and not streamed:
        raise InputError(f"levels of detail are those of streamed SOG: name the output {STREAMED}, in a new folder")
    kind = STREAMED if streamed else _format_to_write(out, to)
    from engine.formats.gltf.metadata import Metadata

    metadata = Metadata(rights, provenance)
    if metadata and kind != "glb":
        raise InputError(f"rights and provenance are stated in a .glb, not in {str(out)!r}")
    if streamed:
        check_folder(out.parent)
    elif out == STREAM:
        check_stdout()
    else:
        refuse_same(model, out)
        check_target(out)

    from engine.scenes.codebook_model import CodebookModel
    from engine.scenes.scene_files import notes_of, read_scene, written_as

    with console.progress() as progress, input_file(model) as file:
        progress("read", 0.0)
        loaded = read_scene(file, name=input_name(model, given), spz_frame=spz_frame)
        check_kind(loaded.format, given, model)
        scene = loaded.scene
        if isinstance(scene, CodebookModel):
            scene = loaded.model  # every index looked up: nothing is lost but the file's size
        else:
            kind = written_as(loaded, kind)
        progress("write", 0.5)
        if streamed:
            counts, bytes_out = _write_streamed(loaded.model, out.parent, levels, progress)
        else:
            counts, bytes_out = [len(scene)], _write(scene, out, kind, metadata)
    notes = notes_of(scene, kind)
    report = {
        "out": str(out),
        "format_in": loaded.format,
        "format_out": kind,
        "bytes_in": loaded.source_bytes,
        "bytes_out": bytes_out,
        "gaussians": counts[0],
        "levels": counts,
        "repairs": [asdict(repair) for repair in loaded.noticed],
        "notes": notes,
        "seconds": time.perf_counter() - began,
    }
    console.note_repairs(loaded.noticed)
    console.say(
        f"{model} ({loaded.format}) -> {out} ({kind}): {' + '.join(f'{count:,}' for count in counts)} Gaussians,"
        f" {loaded.source_bytes:,} -> {bytes_out:,} bytes"
    )
    console.say(*(f"  note: {note}" for note in notes))
    console.emit(report)
    return 0


def _format_to_write(out: Path, to: str | None) -> str:
    if to is not None:
        return format_for(Path(f"out.{to}"))
    if out == STREAM:
        raise InputError("standard output has no ending: name the format with --to")
    return format_for(out)


def _write(scene: Scene, out: Path, kind: str, metadata: Metadata) -> int:
    from engine.formats.gltf.metadata import annotate_glb
    from engine.scenes.scene_files import encode_scene, write_scene

    if not metadata and out != STREAM:
        with whole_file(out) as part:
            return write_scene(scene, part, kind)
    data = encode_scene(scene, kind)
    if metadata:
        data = b"".join(annotate_glb(data, metadata))
    if out == STREAM:
        return write_stdout(data)
    with whole_file(out) as part:
        return part.write_bytes(data)


def _write_streamed(model: GaussianModel, folder: Path, levels: int, progress: Progress) -> tuple[list[int], int]:
    from engine.compress.levels_of_detail import merge_pairs
    from engine.formats.sog.chunks import write_streamed

    made = [model]
    while len(made) < levels:
        progress("merge", len(made) / levels)
        made.append(merge_pairs(made[-1], KEPT, surface=True))
    with whole_folder(folder) as part:
        return [len(level) for level in made], write_streamed(made, part)
