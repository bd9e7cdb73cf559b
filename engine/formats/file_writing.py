"""Models into files: whole or not at all; and what a format cannot hold of a model, row by row: Gaussians far away from
all others, too, to which formats that share one range among many rows would lose the others."""

import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.errors import InputError, UnsupportedFormatError
from engine.formats.declaration import Kind
from engine.formats.known_formats import FORMATS, KIND_BY_NAME, kind_of
from engine.formats.modes import ANTIALIASED, mode_of
from engine.formats.ply.extras import named
from engine.formats.repairs import VISIBLE_ROUNDING
from engine.model import SH_C0, Bool, Carried, Float32, GaussianModel

VISIBLE_LEVELS = 4  # of 255, in a color

STRAY_SHARE = 0.002
"""Of all Gaussians, at most: more of them are a part of the scene. Twice the thousandth that trainers leave behind."""

STRAY_DISTANCE = 64.0
"""Times the extent of all others. In real scenes with their sky the outermost lie within 3 times."""


def encode_model(model: GaussianModel, format: str) -> bytes:
    """The bytes of a file in one of `FORMATS`. All but "ply" round; "splat" drops every coefficient beyond degree 0;
    "spz", "sog" and "compressed.ply" leave out strays that would cost all others their precision, see `loss_note`.
    InputError if the model is empty, UnsupportedFormatError if there is no such format."""
    return b"".join(_encode(model, format))


def loss_note(model: GaussianModel, format: str) -> list[str]:
    """What the format cannot hold of this model, in words."""
    chunked = replace(KIND_BY_NAME["sog"], name=format, rounded=None, step=None)  # levels: each chunk has its own range
    kind, notes = KIND_BY_NAME.get(format, chunked), []
    if "harmonics" not in kind.holds and model.sh_degree > 0:
        notes.append(
            f".{format} stores no spherical harmonics: colour that changes with the view"
            f" (degree {model.sh_degree}) was dropped; the mark survives"
        )
    if "discs" not in kind.holds and model.is_flat:
        bounded = any(each.name == "sizes" for each in kind.ranges)
        thickness = "as thin as it allows" if bounded else "of next to no thickness"
        notes.append(
            f".{format} has three scales: the discs of this 2DGS model were written as Gaussians {thickness},"
            " and other programs draw them as such; .ply keeps two scales; the mark survives"
        )
    if "antialiasing" not in kind.holds and mode_of(model) == ANTIALIASED:
        notes.append(
            f".{format} cannot say that this model is antialiased (SplatRenderMode: mip): viewers draw what is small or"
            " far too heavily unless set to it; .ply, .compressed.ply, .spz and .sog say it; the mark survives"
        )
    if model.carried is not None:
        notes += _dropped(model.carried, kind)
    if any(model.origin) and "origin" not in kind.holds:
        x, y, z = model.origin
        step = np.spacing(np.float32(np.abs(model.means.astype(np.float64) + model.origin).max()))
        notes.append(
            f".{format} rounds centers in map coordinates (float32 by up to {step / 2:.2g}): they were written"
            f" relative to ({x:.0f}, {y:.0f}, {z:.0f}), which is not in the file; .ply keeps it"
        )
    unheld = unheld_rows(model, kind)
    notes += _losses(model.take(~unheld) if unheld.any() else model, kind)
    strays = np.flatnonzero(unheld)
    if len(strays):
        far = float(np.abs(model.means[strays]).max())
        notes.append(
            f"{_counted(model, strays)}, up to {far:.3g} from the others, left out: .{format} rounds all others away"
            " where it holds them; .ply, .splat and .glb hold both"
        )
    return notes


def _dropped(carried: Carried, kind: Kind) -> list[str]:
    parts = [
        f"{len(names)} {noun if len(names) == 1 else plural}{there}"
        for noun, plural, names, there in (
            ("property", "properties", carried.names, f" ({named(carried.names)})"),
            ("comment", "comments", carried.comments, ""),
        )
        if names and plural not in kind.holds
    ]
    found = " and ".join(parts)
    return [f".{kind.name} has no place for what is no Gaussian's: {found} dropped; .ply keeps it"] if found else []


def write_model(model: GaussianModel, path: str | os.PathLike[str], format: str | None = None) -> int:
    """Write a model and return the bytes written; an earlier file of that name is replaced in one step.

    The ending of `path` chooses the format unless one of `FORMATS` is given. InputError if the model is empty, or the
    file cannot be written; UnsupportedFormatError if there is no such format.
    """
    return write_whole(path, _encode(model, format or kind_of(Path(path).name).name))


def write_whole(path: str | os.PathLike[str], pieces: Iterable[bytes]) -> int:
    """Write a file that appears under its name only once it is complete, even if interrupted; returns its bytes.

    A link stays a link; its target is replaced. InputError if the file cannot be written.
    """
    if "\0" in str(path) or not str(path):
        raise InputError(f"{str(path)!r}: is no file name")
    try:
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: is no regular file")
        part = target.with_name(f".{target.name[:40]}.{secrets.token_hex(6)}.part")
        try:
            with open(part, "xb") as file:
                written = sum(file.write(piece) for piece in pieces)
            os.replace(part, target)
        finally:  # also after Ctrl-C; once replaced, there is nothing left to remove
            with suppress(OSError):
                part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    return written


def _encode(model: GaussianModel, format: str) -> Iterable[bytes]:
    if len(model) == 0:
        raise InputError("the model holds no Gaussians: there is nothing to write")
    kind = KIND_BY_NAME.get(format)
    if kind is None or kind.write is None:
        raise UnsupportedFormatError(f"{format!r} is not written here, only {', '.join(FORMATS)}")
    unheld = unheld_rows(model, kind)
    return kind.write(model.take(~unheld) if unheld.any() else model)


def _losses(model: GaussianModel, kind: Kind) -> Iterator[str]:
    """A sentence on each kind of loss beyond rounding, with the number of Gaussians and the first one's row."""
    for each in kind.ranges:
        rows = np.flatnonzero(each.beyond(model))
        if len(rows):
            yield f"{_counted(model, rows)}: {each.name} beyond the range of .{kind.name} were clipped"
    if kind.rounded:
        error = np.abs(kind.rounded(model.means).astype(np.float32) - model.means).max(axis=1)
        size = np.exp(np.median(model.log_scales, axis=1).astype(np.float64))  # of a disc, within its plane
        rows = np.flatnonzero(error > VISIBLE_ROUNDING * size)
        if len(rows):
            most = f"up to {error[rows].max():.2g}, more than 1/20 of their size"
            yield f"{_counted(model, rows)}: .{kind.name} rounds their centers by {most}"
    if kind.colors:
        levels = 255 * SH_C0 * np.abs(kind.colors(model) - model.sh[:, 0]).max(axis=1)
        rows = np.flatnonzero(levels > VISIBLE_LEVELS)
        if len(rows):
            most = f"up to {levels[rows].max():.0f} of 255 levels: another color in the same chunk is extreme"
            yield f"{_counted(model, rows)}: .{kind.name} rounds their colors by {most}"


def _counted(model: GaussianModel, rows: npt.NDArray[np.intp]) -> str:
    noun = "Gaussian" if len(rows) == 1 else "Gaussians"
    return f"{len(rows):,} {noun} (first in row {model.row_of(int(rows[0]))})"


def stray_rows(means: Float32) -> Bool:
    """(N,) which of the centers (N, 3) are strays: few, and beyond `STRAY_DISTANCE` times the extent of the others."""
    points = means.astype(np.float64)
    distance = np.abs(points - np.median(points, axis=0)).max(axis=1)
    kth = int((1 - STRAY_SHARE) * (len(distance) - 1))
    extent = np.partition(distance, kth)[kth]
    return np.asarray((distance > STRAY_DISTANCE * extent) & (extent > 0))


def unheld_rows(model: GaussianModel, kind: Kind) -> Bool:
    """(N,) the strays that a format cannot hold without rounding the others by more than `VISIBLE_ROUNDING`."""
    strays = stray_rows(model.means) if kind.step else np.zeros(len(model), dtype=np.bool_)
    if kind.step and strays.any():
        size = float(np.exp(np.median(model.log_scales[~strays].astype(np.float64).mean(axis=1))))
        if kind.step(model.means.astype(np.float64)) / 2 <= VISIBLE_ROUNDING * size:
            strays[:] = False
    return strays
