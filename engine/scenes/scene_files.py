"""Whatever a file or a folder holds, taken as what it is: plain Gaussians, a clip that moves, a model in codebooks.

The one door by which commands and service come in: `read_scene` and `write_scene`, between them
`scene_marking.embed_scene`; and `Loaded.model` for reading alone. What a format of the output has no place for
is refused by `written_as`, never dropped.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from engine.errors import UnsupportedFormatError
from engine.formats import FORMATS, read_model, write_model
from engine.formats.file_writing import encode_model, loss_note, write_whole
from engine.formats.guards import opening, read_regular
from engine.formats.model_reading import weigh_files
from engine.formats.ply.header import MAX_HEADER_BYTES
from engine.formats.points import read_points
from engine.formats.repairs import Repair
from engine.formats.wrappings import unwrapped
from engine.model import GaussianModel
from engine.scenes.codebook_files import ARGS, CENTERS, INDICES, PLY, read_codebook, write_codebook
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.frame_folders import FrameSequence, frame_files, read_frames, write_frames
from engine.scenes.rotation_order import order_hint
from engine.scenes.spacetime import SpacetimeModel
from engine.scenes.spacetime_ply import is_spacetime, read_spacetime_ply, write_spacetime_ply

__all__ = [
    "CLIPS",
    "CODEBOOK",
    "FOLDERS",
    "FRAMES",
    "POINTS",
    "SPACETIME",
    "Loaded",
    "Scene",
    "encode_scene",
    "folder_kind",
    "notes_of",
    "output_of",
    "read_scene",
    "read_suspect",
    "write_scene",
    "written_as",
]

Scene = GaussianModel | SpacetimeModel | FrameSequence | CodebookModel

SPACETIME, FRAMES, CODEBOOK = "spacetime", "frames", "codebook"
"""What the formats of the others are called: a clip is one ``.ply``, or a folder of a ``.ply`` a moment."""
POINTS = "points"
"""A point cloud, or the corners of a mesh: a suspect only."""
FOLDERS = (FRAMES, CODEBOOK)
CLIPS = (SPACETIME, FRAMES)

_WRITTEN_BY_HAND = ("ply", "glb")  # by scripts of many, which mistake the order of a quaternion
DEFORMATION = "deformation.pth"
"""The network of a 4DGS scene (Wu et al., CVPR 2024), in the folder of the Gaussians that it moves."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """A scene as it came from a file or a folder; see `engine.formats.LoadedModel`."""

    scene: Scene
    format: str  # one of `engine.formats.known_formats.READ`, or "spacetime", "frames", "codebook"
    repairs: tuple[Repair, ...]
    source_bytes: int
    sha256: str

    @cached_property
    def model(self) -> GaussianModel:
        """The scene as plain Gaussians: each of a clip where it is most opaque, each of codebooks looked up."""
        if isinstance(self.scene, SpacetimeModel | FrameSequence):
            return self.scene.canonical()
        return self.scene.decode() if isinstance(self.scene, CodebookModel) else self.scene

    @cached_property
    def noticed(self) -> tuple[Repair, ...]:
        """The repairs, and a hint that concerns only those who publish the model."""
        return (*self.repairs, *(order_hint(self.model) if self.format in _WRITTEN_BY_HAND else ()))


def folder_kind(path: str | os.PathLike[str]) -> str | None:
    """What a folder holds: "codebook" (Compact3D / CompGS), "frames" (one ``.ply`` a moment, two at least, and no
    index of another format); None where it is neither, or no folder."""
    if "\0" in str(path) or not Path(path).is_dir():
        return None
    if (Path(path) / INDICES).is_file():
        return CODEBOOK
    other = any((Path(path) / name).is_file() for name in ("meta.json", "lod-meta.json"))
    return FRAMES if not other and len(frame_files(path)) > 1 else None


def read_scene(path: str | os.PathLike[str], *, name: str | None = None, spz_frame: str = "auto") -> Loaded:
    """Read any file that `engine.formats.read_model` reads, a Spacetime clip, or the folder of a model in codebooks.

    Errors are theirs.
    """
    file = name or str(path)
    with opening(Path(path), file):
        if (kind := folder_kind(path)) is not None:
            return _read_folder(Path(path), kind)
        if "\0" not in file and Path(path).is_file():
            with open(path, "rb") as stream:
                moves = is_spacetime(stream.read(MAX_HEADER_BYTES))
            if moves:
                data = read_regular(Path(path), file)
                clip, repairs = read_spacetime_ply(data, file=file)
                return Loaded(clip, SPACETIME, repairs, len(data), hashlib.sha256(data).hexdigest())
    loaded = read_model(path, name=name, spz_frame=spz_frame)
    repairs = loaded.repairs
    if loaded.format == "ply" and (Path(path).parent / DEFORMATION).is_file():
        text = (
            f"{DEFORMATION!r} in this folder moves these Gaussians: what is said of the look holds for them at rest;"
            " to mark the scene as it moves, export one .ply per moment and give the folder"
        )
        repairs = (*repairs, Repair("deformation_beside", 1, text))
    return Loaded(loaded.model, loaded.format, repairs, loaded.source_bytes, loaded.sha256)


def read_suspect(path: str | os.PathLike[str], *, name: str | None = None, spz_frame: str = "auto") -> Loaded:
    """As `read_scene`; colored points are taken as Gaussians, too, with a repair that says so (`POINTS`)."""
    try:
        return read_scene(path, name=name, spz_frame=spz_frame)
    except UnsupportedFormatError:
        file = name or str(path)
        with opening(Path(path), file):
            data = b"" if Path(path).is_dir() else read_regular(Path(path), file)
        folder = Path(path).parent if name is None else None  # another's file may not name those beside it
        with unwrapped(data, folder, file=file) as (content, beside, _):
            if (found := read_points(content, file=file, folder=beside)) is None:
                raise
        return Loaded(found[0], POINTS, found[1], len(data), hashlib.sha256(data).hexdigest())


def _read_folder(folder: Path, kind: str) -> Loaded:
    scene: Scene = read_codebook(folder) if kind == CODEBOOK else read_frames(folder)
    parts = (PLY, CENTERS, INDICES, ARGS) if kind == CODEBOOK else [path.name for path in frame_files(folder)]
    return Loaded(scene, kind, (), *weigh_files(folder, parts))


def written_as(loaded: Loaded, kind: str) -> str:
    """The format in which a marked scene is written, where `kind` is requested; UnsupportedFormatError names what
    this format would lose."""
    if isinstance(loaded.scene, SpacetimeModel):
        if kind not in ("ply", SPACETIME):
            message = (
                f".{kind} has no place for motion: trbf_center, trbf_scale, motion_0 to 8 and omega_0 to 3 would be"
                " lost; write the marked clip as .ply"
            )
            raise UnsupportedFormatError(message)
        return SPACETIME
    own = loaded.format if loaded.format in FOLDERS else None
    if (own is not None or kind in FOLDERS) and kind != own:
        raise UnsupportedFormatError(f"{loaded.format} is written as {own or 'one file'}, not as {kind!r}")
    return kind


def output_of(loaded: Loaded) -> str:
    """The format in which a marked scene is written by default: its own, if that is written at all."""
    return loaded.format if loaded.format in (*FORMATS, *FOLDERS) else "ply"


def write_scene(scene: Scene, path: str | os.PathLike[str], kind: str) -> int:
    """Write a scene, in the format that `written_as` named; returns its bytes."""
    if isinstance(scene, SpacetimeModel):
        return write_whole(path, write_spacetime_ply(scene))
    if isinstance(scene, FrameSequence):
        return write_frames(scene, path)
    return write_codebook(scene, path) if isinstance(scene, CodebookModel) else write_model(scene, path, kind)


def encode_scene(scene: Scene, kind: str) -> bytes:
    """The same, where one file holds it: its bytes."""
    if isinstance(scene, SpacetimeModel):
        return b"".join(write_spacetime_ply(scene))
    if isinstance(scene, CodebookModel | FrameSequence):
        raise UnsupportedFormatError(f"{kind} is a folder, no single file")
    return encode_model(scene, kind)


def notes_of(scene: Scene, kind: str) -> list[str]:
    """What the owner should know of the file: what its format cannot hold, what it is verified with."""
    if isinstance(scene, SpacetimeModel | FrameSequence):
        return ["to verify a moment exported from this clip, or a picture of it, give the unmarked clip as well"]
    return [] if isinstance(scene, CodebookModel) else loss_note(scene, kind)
