"""What every handler and every flow works with: settings, tables, blobs, the master key and the jobs."""

from __future__ import annotations

import logging
import stat
from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict

import sqlalchemy as sa

from engine.errors import InputError
from service.blobs import Blobs
from service.db import Database, fact
from service.db.schema import facts
from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import Run
from service.problems import Problem
from service.processes import Answer, Reply
from service.settings import Settings
from service.trust import audit
from service.trust.api_keys import Caller
from service.trust.commitments import registration_of
from service.trust.draws import vouching
from service.trust.master import MasterKey
from service.trust.owner_keys import open_key

PUBLIC_URL = "public_url"
"""Name of the fact: address of this service as its owner entered it."""

RESTORING = "restoring"
"""Folder in the data folder in which a backup is laid out before it takes its place."""

_log = logging.getLogger(__name__)


class Candidate(TypedDict):
    """An asset that a suspect may derive from, as tasks take it."""

    asset: str  # its id
    original: str  # SHA-256
    record: str  # path; "" where it is gone
    key: str  # secret owner key, hex
    logged: dict[str, str]  # when the log registered it: `at`
    vouched: str  # certificates (PEM) that vouch for the time-stamping service that drew for it; "" for none


@dataclass(frozen=True)
class Service:
    """One process's view of the service."""

    settings: Settings
    db: Database
    blobs: Blobs
    master: MasterKey
    jobs: DurableJobs
    making: dict[tuple[str, str], tuple[str, Future[str]]] = field(default_factory=dict)  # conversions, whose they are

    @classmethod
    def open(cls, settings: Settings) -> Service:
        """Open what the settings name; tables are brought up to date, the master key is made on the first start."""
        _keep_apart(settings.data_dir)
        db = Database(settings.database())
        db.migrate()
        blobs = Blobs(settings.blob_url, settings.data_dir / "blobs", settings.scratch)
        return cls(settings, db, blobs, MasterKey.open(settings, db), DurableJobs(db, settings.jobs_database()))

    def public_url(self) -> str:
        """Address of this service, without a slash at its end: the setting, else what was entered; "" for none."""
        if not (url := self.settings.public_url):
            with self.db.read() as connection:
                url = fact(connection, PUBLIC_URL) or ""
        return url.rstrip("/")

    def set_public_url(self, caller: Caller, url: str) -> None:
        """Store the address of this service for later links, "" for none; "conflict" where a setting has it."""
        if self.settings.public_url:
            raise Problem("conflict", f"MARK3DGS_PUBLIC_URL sets the address: {self.settings.public_url}")
        with self.db.exclusive() as connection:
            connection.execute(sa.delete(facts).where(facts.c.name == PUBLIC_URL))
            connection.execute(facts.insert().values(name=PUBLIC_URL, value=url))
            audit.append(connection, caller.tenant, "service.addressed", {"public_url": url}, caller.tenant)

    def do_task(self, run: Run, task: str, request: Mapping[str, Any], answer: Answer | None = None) -> Reply:
        """Do a task of `service.work` in a step; its reply, with `kept` (name -> SHA-256) in place of its `files`."""
        reply = run.work(task, request) if answer is None else run.work(task, request, answer)
        files: dict[str, str] = reply.pop("files", {})
        return reply | {"kept": {name: self.blobs.put(run.folder / file) for name, file in files.items()}}

    def local(self, sha256: str | None, run: Run) -> str | None:
        """Path where a step can read a blob, if there is one."""
        return str(self.blobs.local(sha256, run.folder)) if sha256 else None

    def local_model(self, request: Mapping[str, Any], run: Run) -> dict[str, str | None]:
        """The model of a job's request as tasks take it, with its sender's name for it: jobs of earlier versions have
        none."""
        model = self.local(request["model"], run)
        names = (request.get("names") or [""]) if model else [""]
        return {"model": model, "spz_frame": request.get("spz_frame", "auto"), "name": names[0]}

    def local_or_gone(self, sha256: str, run: Run) -> str:
        """The same of a blob that others rely on, too; "" where it is gone, for its reader to report."""
        try:
            return self.local(sha256, run) or ""
        except Problem as problem:
            if problem.kind != "not-found":
                raise
            return ""

    def candidates(self, rows: Iterable[Any], run: Run) -> list[Candidate]:
        """Rows of the table `assets` as tasks take them; their owner keys go through a pipe only.

        An asset whose owner key was erased cannot be looked for: it is left out.
        """
        rows = list(rows)
        found: list[Candidate] = []
        with self.db.read() as connection:
            logged = {row.id: {"at": registration_of(connection, row.id).at} for row in rows}
        vouched = vouching(self.settings)
        for row in rows:
            try:
                key = open_key(self.db, self.master, row.tenant, row.owner_key)
            except Problem as problem:
                if problem.kind != "not-found":
                    raise
                continue
            found.append(
                {
                    "asset": row.id,
                    "original": row.original_sha256,
                    "record": self.local_or_gone(row.record_sha256, run),
                    "key": key.secret.hex(),
                    "logged": logged[row.id],
                    "vouched": vouched,
                }
            )
        return found

    def close(self) -> None:
        """Give connections back."""
        self.db.close()


def _keep_apart(folder: Path) -> None:
    """Make the data folder, or take the others' rights to it away: other users cannot read it.

    InputError where a restore was broken off in it.
    """
    if (folder / RESTORING).exists():
        raise InputError(f"a backup is being restored into {folder}, or was broken off: empty it and restore again")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    mode = stat.S_IMODE(folder.stat().st_mode)
    if mode & 0o077:
        try:
            folder.chmod(0o700)
        except OSError:
            raise InputError(f"{folder} has mode {mode:04o}, so others may read it: run chmod 700 on it") from None
        _log.warning("%s had mode %04o: others could read it, and now cannot", folder, mode)
