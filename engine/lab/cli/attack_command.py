"""`mark3dgs attack`: what happens to stolen models and screenshots, on purpose."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from engine.cli.console import Console
from engine.cli.options import Json, SpzFrame
from engine.errors import InputError
from engine.lab.cli.shared import Seed
from engine.usecases.files import (
    JPEG_QUALITY,
    check_picture_ending,
    check_target,
    format_for,
    refuse_same,
    whole_file,
    write_picture,
)

if TYPE_CHECKING:
    from engine.lab.sim.attack import Attack
    from engine.model import Float32, GaussianModel


def _list_attacks(wanted: bool) -> None:
    if not wanted:
        return
    from engine.lab.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS

    for title, attacks in (("On models", MODEL_ATTACKS), ("On pictures", IMAGE_ATTACKS)):
        typer.echo(f"{title}:")
        for known in attacks.values():
            for reading in known.readings:
                typer.echo(
                    f"  {known.name:<17} {reading.label:<8} {known.summary}; strength: {reading.meaning}"
                    f" (default {reading.default})"
                )
    raise typer.Exit()


def attack(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Attack; --list names them all.")],
    target: Annotated[Path, typer.Argument(metavar="MODEL|PICTURE", help="Model or picture to attack.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Result; its ending names the format.")],
    strength: Annotated[
        str | None, typer.Option("--strength", metavar="S", help="In the attack's own unit, see --list.")
    ] = None,
    seed: Seed = 0,
    reading: Annotated[
        str | None,
        typer.Option("--reading", metavar="literal|as_code", help="As papers word it, or as public code runs it."),
    ] = None,
    into: Annotated[Path | None, typer.Option("--into", help="merge_into: the foreign scene.")] = None,
    to: Annotated[
        str | None, typer.Option("--to", metavar="FORMAT", help="convert: format to go through, see --list.")
    ] = None,
    spz_frame: SpzFrame = "auto",
    list_all: Annotated[
        bool, typer.Option("--list", callback=_list_attacks, is_eager=True, help="List all attacks with their units.")
    ] = False,
    json: Json = False,
) -> int:
    """Attack a model or a picture; the same seed gives the same result.

    Examples:

      mark3dgs attack --list
      mark3dgs attack crop marked.ply stolen.ply --strength 0.25 --seed 7
      mark3dgs attack convert marked.ply stolen.spz
      mark3dgs attack merge_into marked.ply stolen.ply --into other.ply
      mark3dgs attack jpeg shot.png stolen.jpg --strength 30
    """
    console = Console(json)
    began = time.perf_counter()
    check_target(out)
    refuse_same(target, out)
    from engine.formats.image_files import is_picture
    from engine.lab.sim.attacks import find_attack

    chosen = find_attack(name)
    picture = is_picture(target)
    if picture != (chosen.kind == "image"):
        what = "a picture" if picture else "a model"
        raise InputError(f"attack {name!r} works on {chosen.kind}s, but {str(target)!r} is {what}")
    if into is not None and name != "merge_into":
        raise InputError(f"--into belongs to merge_into, not to {name!r}")
    if to is not None and name != "convert":
        raise InputError(f"--to belongs to convert, not to {name!r}")
    if to is not None and strength is not None:
        raise InputError("the strength of convert is the format: give --to alone")
    value = to if to is not None else _strength(strength, chosen)
    chosen_reading = chosen.reading(reading)
    used = chosen_reading.default if value is None else value
    apply: Callable[..., Any] = partial(chosen.apply, strength=value, rng=seed, reading=reading)
    with console.progress() as progress:
        progress(name, 0.0)
        if picture:
            done = _attack_picture(apply, target, out, int(used) if name == "jpeg" else JPEG_QUALITY)
        else:
            if name == "convert" and value is None:  # the output's own format is the conversion
                apply, used = lambda model: model, format_for(out)
            done = _attack_model(apply, target, out, into, spz_frame, console)
    report = done.sizes | {
        "attack": name,
        "kind": chosen.kind,
        "strength": used,
        "meaning": chosen_reading.meaning,
        "reading": chosen_reading.label,
        "seed": seed,
        "out": str(out),
        "bytes_out": out.stat().st_size,
        "seconds": time.perf_counter() - began,
    }
    console.say(f"{name} {used} ({chosen_reading.meaning}), seed {seed}: {target} -> {out}, {done.summary}")
    for note in done.notes:
        console.say(f"  note: {note}")
    console.emit(report)
    return 0


def _strength(text: str | None, chosen: Attack[Any]) -> float | str | None:
    if text is None or isinstance(chosen.default, str):
        return text
    try:
        return float(text)
    except ValueError:
        raise InputError(
            f"attack {chosen.name!r} takes as strength a number ({chosen.meaning}), got {text!r}"
        ) from None


class _Done(NamedTuple):
    """What an attack did: the first part of the JSON report, a summary for people, notes on what was lost."""

    sizes: dict[str, object]
    summary: str
    notes: Sequence[str] = ()


def _attack_model(
    apply: Callable[..., GaussianModel], target: Path, out: Path, into: Path | None, spz_frame: str, console: Console
) -> _Done:
    from engine.formats import read_model, write_model
    from engine.formats.file_writing import loss_note

    kind = format_for(out)
    loaded = read_model(target, spz_frame=spz_frame)
    console.note_repairs(loaded.repairs)
    options = {"other": read_model(into, spz_frame=spz_frame).model} if into is not None else {}
    result = apply(loaded.model, **options)
    with whole_file(out) as part:
        write_model(result, part, kind)
    notes = loss_note(result, kind)
    sizes = {"gaussians_in": len(loaded.model), "gaussians_out": len(result), "notes": notes}
    return _Done(sizes, f"{len(loaded.model):,} -> {len(result):,} Gaussians", notes)


def _attack_picture(apply: Callable[[Float32], Float32], target: Path, out: Path, quality: int) -> _Done:
    """`quality` of a JPEG file: that of the attack `jpeg` is coded once more with the same tables."""
    from engine.formats.image_files import read_picture

    check_picture_ending(out)
    image = read_picture(target)
    result = apply(image)
    before, after = (f"{picture.shape[1]} x {picture.shape[0]}" for picture in (image, result))
    with whole_file(out) as part:
        write_picture(result, part, out, quality)
    sizes: dict[str, object] = {
        "size_in": [image.shape[1], image.shape[0]],
        "size_out": [result.shape[1], result.shape[0]],
    }
    return _Done(sizes, f"{before} -> {after} pixels")
