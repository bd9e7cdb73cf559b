"""A suspect as it comes to a request: from the files that an owner names, or from wherever a service keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from engine.errors import InputError

if TYPE_CHECKING:
    from engine.flows.verify.search import Suspect
    from engine.formats import Repair

__all__ = ["ReadSuspect", "SuspectFiles", "SuspectSource"]


@dataclass(frozen=True, eq=False)
class ReadSuspect:
    """A suspect, read."""

    suspect: Suspect
    format: str = "pictures"  # or the model's
    repairs: tuple[Repair, ...] = ()  # what was mended on loading


class SuspectSource(Protocol):
    """Where a suspect comes from."""

    def read(self) -> ReadSuspect:
        """The suspect; raises the errors of its files."""


@dataclass(frozen=True)
class SuspectFiles:
    """One model, or pictures of one; InputError where they are neither."""

    paths: tuple[Path, ...]
    pictures: bool  # whether they are pictures
    cameras: Path | None = None  # of the pictures, in their order; found by search if left out
    spz_frame: str = "auto"  # axes of .spz input: "auto", "spec" or "ply"
    name: str | None = None  # what errors call a model; default: its path

    @classmethod
    def sort_out(
        cls, paths: Sequence[Path], cameras: Path | None = None, spz_frame: str = "auto", name: str | None = None
    ) -> SuspectFiles:
        """The files that paths name: in the place of a folder of pictures alone, such as a video's frames, these in
        order of name. Each file is opened once to see what it is."""
        from engine.formats.image_files import is_picture

        found: list[tuple[Path, bool]] = []
        for path in paths:
            within = sorted(each for each in path.iterdir() if not _is_hidden(each)) if path.is_dir() else []
            if within and all(is_picture(each) for each in within):
                found += [(each, True) for each in within]
            else:
                found.append((path, is_picture(path)))
        pictures = [is_one for _, is_one in found]
        if any(pictures) and not all(pictures):
            raise InputError("suspects are one model, or pictures of one model, not both at once")
        if not any(pictures) and len(found) > 1:
            raise InputError(f"one model at a time; got {', '.join(repr(str(path)) for path, _ in found)}")
        if cameras is not None and not any(pictures):
            raise InputError("--cameras is only allowed with pictures")
        return cls(tuple(path for path, _ in found), any(pictures), cameras, spz_frame, name)

    def read(self) -> ReadSuspect:
        """The model, or the pictures and their cameras."""
        if self.pictures:
            from engine.formats import read_cameras
            from engine.formats.image_files import read_picture

            known = read_cameras(self.cameras) if self.cameras is not None else None
            seen = [read_picture(path) for path in self.paths]
            from engine.flows.verify.search import Suspect

            return ReadSuspect(Suspect(None, seen, known))
        from engine.scenes.scene_files import read_suspect

        loaded = read_suspect(self.paths[0], name=self.name, spz_frame=self.spz_frame)
        from engine.flows.verify.search import Suspect  # after the file: to import it takes as long as to read it

        return ReadSuspect(Suspect(loaded.model), loaded.format, loaded.repairs)


def _is_hidden(path: Path) -> bool:
    """Whether this is a file that systems put into folders and do not show."""
    return path.name.startswith(".") or path.name.lower() in ("thumbs.db", "desktop.ini")
