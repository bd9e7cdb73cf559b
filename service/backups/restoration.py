"""Restoring a backup into an empty data folder: laid out next to its place, checked whole, then moved there.

1. Every file of the backup is copied and checked against its digest; one that is missing or differs ends it.
2. The copy is opened as the service would open it: its tables are brought up to this version, its master key must fit.
3. It is audited. What is found now was so when the backup was taken; it is reported, and does not stop the restoration.
4. Everything moves to its place, the database last: before, no command sees a service there. Until it is over, a
   marker keeps `serve` from making a new one in what is half there.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from engine.errors import InputError
from service.backups.manifest import Manifest, check_local, copy_file, filling
from service.core import RESTORING, Service
from service.settings import DATABASE, Settings
from service.trust.audit_check import LogReport, verify_log
from service.trust.master import FILE as MASTER_FILE

IGNORED = frozenset({"scratch", "numba", "lost+found"})
"""What an empty data folder may hold: a container makes the first two before any command runs."""


def restore(settings: Settings, source: Path, tell: Callable[[float], None]) -> tuple[Manifest, LogReport]:
    """Put a backup into the data folder of the settings; its files, and what the audit of them found.

    InputError if the data folder is not empty, the backup is damaged or not whole, or a master key is wanting;
    MasterKeyError if it is another's. Whatever ends this early leaves the data folder as it was.
    """
    check_local(settings)
    manifest, data = Manifest.read(source), settings.data_dir.absolute()
    if MASTER_FILE not in manifest.files and settings.master_key is None:
        raise InputError("this backup was taken without the master key: set MARK3DGS_MASTER_KEY to it")
    with filling(data, ignored=IGNORED):
        stage = data / RESTORING
        stage.mkdir(mode=0o700)
        for number, (name, expected) in enumerate(sorted(manifest.files.items()), start=1):  # 1
            try:
                found = copy_file(source / name, stage / name)
            except FileNotFoundError:
                raise InputError(f"this backup is damaged: {name} is missing") from None
            if found != expected:
                raise InputError(f"this backup is damaged: {name} is not the file that was backed up")
            tell(number / len(manifest.files))
        service = Service.open(settings.model_copy(update={"data_dir": stage}))  # 2
        try:
            report = verify_log(service.db, manifest)  # 3
        finally:
            service.close()
        shutil.rmtree(stage / "scratch")
        os.sync()
        for path in sorted(stage.iterdir(), key=lambda each: each.name == DATABASE):  # 4
            os.replace(path, data / path.name)
        os.sync()
        stage.rmdir()
    return manifest, report
