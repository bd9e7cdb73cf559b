"""`mark3dgs backup` and `mark3dgs restore`: for operators of a service that keeps everything in its data folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console
from engine.cli.embed import size
from engine.cli.options import Json
from service.cli.serve import settings_of

if TYPE_CHECKING:
    from service.backups.manifest import Manifest
    from service.trust.audit_check import LogReport


def backup(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Target: a new folder, or an empty one.")],
    without_master_key: Annotated[
        bool, typer.Option("--without-master-key", help="Leave the master key out: keep it elsewhere, apart.")
    ] = False,
    json: Json = False,
) -> int:
    """Back up a service, also while it runs: databases, stored files and keys.

    The copy is consistent and was audited as it was made; 'mark3dgs restore'
    makes a service of it. With the master key it gives access to every
    owner key: protect it like the data folder, or leave that key out.
    A service with PostgreSQL or S3 is backed up by their own tools: see
    docs/OPERATIONS.md. Exit codes: 0 done, 3 done, and the audit found faults.

    Examples:

      mark3dgs backup backups/2026-11-23
    """
    from service.backups.snapshot import take

    console = Console(json)
    settings = settings_of()
    with console.progress() as progress:
        manifest, report = take(
            settings, folder, lambda share: progress("copying files", share), master_key=not without_master_key
        )
    keyless = " without the master key: without that, it opens nothing" if without_master_key else ""
    return _report(console, f"backed up {settings.data_dir} to {folder}{keyless}", manifest, report)


def restore(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="What 'mark3dgs backup' made.")], json: Json = False
) -> int:
    """Make a service of a backup, in an empty data folder (MARK3DGS_DATA_DIR).

    Every file is checked against its digest before any takes its place, and the
    log is audited; a damaged or half-written backup is refused. Do not run two
    services from one backup: their logs would contradict each other.
    Exit codes: 0 done, 3 done, and the audit found what was damaged already
    when the backup was taken.

    Examples:

      MARK3DGS_DATA_DIR=mark3dgs-restored mark3dgs restore backups/2026-11-23
    """
    from service.backups.restoration import restore as put_back

    console = Console(json)
    settings = settings_of()
    with console.progress() as progress:
        manifest, report = put_back(settings, folder, lambda share: progress("copying files", share))
    return _report(console, f"restored {settings.data_dir} from {folder}", manifest, report)


def _report(console: Console, text: str, manifest: Manifest, report: LogReport) -> int:
    count = sum(file.bytes for file in manifest.files.values())
    console.say(f"{text}: {len(manifest.files)} files, {size(count)}, begun {manifest.made_at[:19]} UTC")
    console.say(report.text())
    summary = {"made_at": manifest.made_at, "files": len(manifest.files), "bytes": count, "audit": report.to_json()}
    console.emit(summary)
    return 0 if report.ok else 3
