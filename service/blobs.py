"""Content-addressed files: a blob's name is the SHA-256 of its bytes. A local folder by default, S3 by URL."""

import hashlib
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import obstore
from obstore.store import LocalStore, ObjectStore, from_url

from engine.errors import InputError
from service.problems import Problem

_CHUNK = 4 << 20


class Blobs:
    """Files by digest, and parts of uploads by name, in a folder or (by a URL s3://...) in a store.

    Files in the making lie in `scratch`, on the file system of the folder, so that putting a file is a rename.
    """

    def __init__(self, url: str, folder: Path, scratch: Path) -> None:
        scratch.mkdir(parents=True, exist_ok=True)
        self.scratch = scratch
        self.folder = None if url else folder.absolute()
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.store: ObjectStore = LocalStore(self.folder, mkdir=True)
        else:
            try:
                self.store = from_url(url)
            except Exception as error:  # the library's own kinds
                raise InputError(f"MARK3DGS_BLOB_URL is no address of a store: {error}") from None

    @contextmanager
    def new_file(self) -> Iterator[Path]:
        """A fresh path in the scratch folder; whatever is left there at the end is removed."""
        path = self.scratch / secrets.token_hex(16)
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def put(self, path: Path, sha256: str | None = None) -> str:
        """Keep a file for good, and return its digest; the path is used up. Twice the same is once.

        Durable when it returns: the bytes and the folder's entry are on the disk (or in the store).
        """
        digest = sha256 or digest_of(path)
        self.put_part(path, blob_name(digest))
        return digest

    def put_part(self, path: Path, name: str) -> None:
        """Keep a file, such as a part of an upload, under a name of ours; the path is used up."""
        if self.folder is None:
            obstore.put(self.store, name, path)
            path.unlink()
            return
        target = self.folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        _sync(path)
        os.replace(path, target)
        _sync(target.parent)

    def local(self, sha256: str, into: Path) -> Path:
        """A path where the blob can be read: its own where blobs are local, else a copy in the folder `into`."""
        name = blob_name(sha256)
        if self.folder is not None:
            path = self.folder / name
            if not path.is_file():
                raise Problem("not-found", f"the blob {name} is gone")
            return path
        into.mkdir(parents=True, exist_ok=True)
        target = into / sha256
        if not target.exists():
            part = target.with_suffix(".part")
            with part.open("wb") as file:
                file.writelines(self.chunks(name))
            part.replace(target)
        return target

    def chunks(self, name: str) -> Iterator[bytes]:
        """The bytes under a name, some MiB at a time; not-found where there are none."""
        try:
            for chunk in obstore.get(self.store, name).stream(min_chunk_size=_CHUNK):
                yield bytes(chunk)
        except FileNotFoundError:
            raise Problem("not-found", f"the blob {name} is gone") from None

    def read(self, sha256: str) -> bytes:
        """The bytes of a small blob."""
        try:
            return bytes(obstore.get(self.store, blob_name(sha256)).bytes())
        except FileNotFoundError:
            raise Problem("not-found", f"the blob {sha256} is gone") from None

    def digest_found(self, sha256: str) -> str:
        """SHA-256 of the bytes that lie under that digest; "" where there are none."""
        found = hashlib.sha256()
        try:
            for chunk in self.chunks(blob_name(sha256)):
                found.update(chunk)
        except (Problem, ValueError):
            return ""
        return found.hexdigest()

    def remove_part(self, name: str) -> None:
        """Forget a part of an upload."""
        with suppress(FileNotFoundError):
            obstore.delete(self.store, name)

    def free_bytes(self) -> int:
        """Space left for files in the making."""
        return shutil.disk_usage(self.scratch).free


def blob_name(sha256: str) -> str:
    """Name in the store; the digest is checked, so that no name from outside becomes a path."""
    if len(sha256) != 64 or not set(sha256) <= set("0123456789abcdef"):
        raise ValueError(f"no SHA-256 digest: {sha256!r}")
    return f"blob/{sha256[:2]}/{sha256}"


def digest_of(path: Path) -> str:
    """SHA-256 of a file, hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
