"""What a backup is: a folder of files, and the list of them, which is written last and makes it one."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from engine.errors import InputError
from service.blobs import blob_name
from service.settings import DATABASE, Settings

NAME = "backup.json"
FORMAT = 1
BLOBS = "blobs"
"""Folder of the stored files, in data folder and backup."""
_CHUNK = 4 << 20


@dataclass(frozen=True)
class File:
    """A file of a backup."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """The files of a backup, by their paths in it with forward slashes; and when it was begun (UTC, ISO 8601)."""

    made_at: str
    files: Mapping[str, File]

    def digest_found(self, sha256: str) -> str:
        """As `Blobs.digest_found`, of what was copied."""
        found = self.files.get(f"{BLOBS}/{blob_name(sha256)}")
        return found.sha256 if found is not None else ""

    def write(self, folder: Path) -> None:
        """Make the folder a backup; the file appears whole or not at all."""
        plain = {"format": FORMAT, "made_at": self.made_at, "files": {name: vars(f) for name, f in self.files.items()}}
        part = folder / f"{NAME}.part"
        part.write_text(json.dumps(plain, indent=1))
        part.replace(folder / NAME)

    @classmethod
    def read(cls, folder: Path) -> Manifest:
        """The list of a folder's files; InputError where the folder is no whole backup, or one of a later version."""
        try:
            plain = json.loads((folder / NAME).read_bytes())
            if int(plain["format"]) > FORMAT:
                raise InputError(f"a later version of this program wrote {folder}: use that one")
            made_at = str(plain["made_at"])
            files = {str(name): File(int(f["bytes"]), str(f["sha256"])) for name, f in plain["files"].items()}
        except (FileNotFoundError, NotADirectoryError):
            text = f"{folder} is no backup, or one that was broken off: {NAME}, which is written last, is not in it"
            raise InputError(text) from None
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(f"{folder / NAME} is damaged: take another backup") from None
        for name in map(PurePosixPath, files):
            if name.is_absolute() or ".." in name.parts or not name.parts:
                raise InputError(f"{folder / NAME} is damaged: {str(name)!r} is no file of a backup")
        if DATABASE not in files:
            raise InputError(f"{folder / NAME} is damaged: it lists no {DATABASE}")
        return cls(made_at, files)


def copy_file(source: Path, target: Path) -> File:
    """Copy a file to a new one and tell its length and digest, as read."""
    digest, length = hashlib.sha256(), 0
    with source.open("rb") as old:
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as new:
            while chunk := old.read(_CHUNK):
                digest.update(chunk)
                length += new.write(chunk)
    return File(length, digest.hexdigest())


def check_local(settings: Settings) -> None:
    """InputError, which says what to use instead, unless everything lies in the data folder."""
    elsewhere = {
        "MARK3DGS_DATABASE_URL": (settings.database_url, "tables are in PostgreSQL: pg_dump and pg_restore copy them"),
        "MARK3DGS_BLOB_URL": (settings.blob_url, "files are in a store: copy them by its own tools"),
    }
    found = [f"{text} ({name})" for name, (url, text) in elsewhere.items() if url]
    if found:
        raise InputError(f"this service's {'; its '.join(found)}. See docs/OPERATIONS.md")


@contextmanager
def filling(folder: Path, *, ignored: frozenset[str] = frozenset()) -> Iterator[None]:
    """Fill a folder that is not there, or holds nothing but `ignored`; if the block raises, it is as it was before."""
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    there = sorted(path.name for path in folder.iterdir() if path.name not in ignored)
    if there:
        raise InputError(f"{folder} is not empty: it holds {there[0]!r}. Name an empty folder, or a new one")
    try:
        yield
    except BaseException:
        for path in folder.iterdir():
            if path.is_dir() and path.name not in ignored:
                shutil.rmtree(path)
            elif path.name not in ignored:
                path.unlink()
        if made:
            folder.rmdir()
        raise
