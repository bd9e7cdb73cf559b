"""Taking a backup of a service that runs. Nothing waits for it; the order of the steps makes the copy consistent:

1. The stored files. A file is whole before a row, or a step that a job has kept, names it; it goes only when nothing
   names it any more and it is older than an upload may be.
2. The job engine's database, then ours, each by SQLite's online backup: one moment of it, while writers continue.
   Ours is the later moment. So a job that the engine's copy does not know is enqueued again, and one that has ended
   meanwhile finds nothing left to do. The other way round it would be taken for one without a result, and fail.
3. The stored files that came since. What the databases name and 1 has not copied is younger than this backup, and no
   tidying up takes it.
4. The master key's file, and whatever else lies in the data folder.
5. The copy is audited as `mark3dgs audit verify` does, and the list of its files is written, without which it is no
   backup.

What happens meanwhile: an asset or claim deleted before 2 is not in the backup (files of it may be, and go with the
next tidying up), one deleted after 2 is. A job at work continues, where the backup is restored, at its last finished
step. Uploads under way are left out: their clients start again. So are what can be made anew (scratch, index of the
assets, compiled kernels), and `admin.key`.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from pathlib import Path

import sqlalchemy as sa

from engine.errors import InputError
from service.backups.manifest import BLOBS, File, Manifest, check_local, copy_file, filling
from service.blobs import digest_of
from service.clock import now
from service.db import Database
from service.db.schema import uploads
from service.settings import DATABASE, JOBS_DATABASE, Settings
from service.trust.audit_check import LogReport, verify_log
from service.trust.master import FILE as MASTER_FILE
from service.trust.master import MasterKey

LEFT_OUT = {DATABASE, JOBS_DATABASE, "admin.key"}
"""Files of the data folder that are not copied as they lie there; the last was for a person to read and delete."""
_FLEETING = ("-wal", "-shm", "-journal", ".new", ".part")
"""Ends of names: SQLite's own files of a database, and files in the making."""


def take(
    settings: Settings, target: Path, tell: Callable[[float], None], *, master_key: bool = True
) -> tuple[Manifest, LogReport]:
    """Back a service up into a folder that is empty or not there; its files, and what the audit of the copy found.

    A damaged file of the service is copied as it is, and reported. InputError if the service does not keep everything
    in its data folder, is of another version, or is none; MasterKeyError if its master key is another one's. Whatever
    ends this early leaves no backup behind.

    Parameters
    ----------
    tell : callable
        Called with the share of the stored files that is copied.
    master_key : bool
        Whether the master key's file goes along. With it, the backup gives access to every owner key.
    """
    check_local(settings)
    data, made_at = settings.data_dir.absolute(), now()
    if data.resolve() in (target.resolve(), *target.resolve().parents):
        raise InputError(f"{target} lies in the data folder {data}: back up to another place, best another disk")
    _check_version(settings)
    with filling(target):
        files: dict[str, File] = {}
        _copy(data, target, _stored(data), files, tell)  # 1
        for name in (JOBS_DATABASE, DATABASE):  # 2
            if (data / name).exists():
                _copy_database(data / name, target / name)
        copied = settings.model_copy(update={"data_dir": target})
        db = Database(copied.database())
        with closing(db):
            db.change(sa.delete(uploads).where(uploads.c.state == "open"))
            _copy(data, target, _stored(data), files, tell)  # 3
            _copy(data, target, _others(data, master_key), files, lambda share: None)  # 4
            if master_key:
                MasterKey.open(copied, db)
            report = verify_log(db, Manifest(made_at, files))  # 5
        for name in (JOBS_DATABASE, DATABASE):
            if (target / name).exists():
                files[name] = File((target / name).stat().st_size, digest_of(target / name))
        os.sync()
        manifest = Manifest(made_at, files)
        manifest.write(target)
        os.sync()
    return manifest, report


def _check_version(settings: Settings) -> None:
    """Commands of another version bring a database up to date, under the feet of the service that runs; not this."""
    with closing(Database(settings.database())) as db:
        if not db.exists:
            raise InputError(f"there is no service in {settings.data_dir}")
        if not db.is_current:
            text = "another version of this program made, or uses, this database: take the backup with that one"
            raise InputError(text)


def _stored(data: Path) -> list[str]:
    """Stored files by their names in the data folder; parts of uploads are none."""
    return [path.relative_to(data).as_posix() for path in sorted((data / BLOBS / "blob").glob("??/*"))]


def _others(data: Path, master_key: bool) -> list[str]:
    """Files but databases and stored files."""
    out = LEFT_OUT if master_key else LEFT_OUT | {MASTER_FILE}
    names = sorted(path.name for path in data.iterdir() if path.is_file())
    return [name for name in names if name not in out and not name.endswith(_FLEETING)]


def _copy(
    data: Path, target: Path, names: Iterable[str], files: dict[str, File], tell: Callable[[float], None]
) -> None:
    """Copy what has not been copied; a file that is gone by now belonged to no row."""
    missing = [name for name in names if name not in files]
    for number, name in enumerate(missing, start=1):
        with suppress(FileNotFoundError):
            files[name] = copy_file(data / name, target / name)
        tell(number / len(missing))


def _copy_database(source: Path, target: Path) -> None:
    try:
        with (
            closing(sqlite3.connect(f"{source.as_uri()}?mode=rw", uri=True, timeout=30)) as live,
            closing(sqlite3.connect(target)) as copy,
        ):
            live.backup(copy)
    except sqlite3.Error as error:  # damaged, or no room
        raise InputError(f"{source} cannot be copied to {target}: {error}") from None
