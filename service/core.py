"""What every handler and every flow works with: settings, tables, blobs, the master key and the jobs."""

from __future__ import annotations

from dataclasses import dataclass

from service.blobs import Blobs
from service.db import Database
from service.jobs.durable import DurableJobs
from service.settings import Settings
from service.trust.master import MasterKey


@dataclass(frozen=True)
class Service:
    """One process's view of the service."""

    settings: Settings
    db: Database
    blobs: Blobs
    master: MasterKey
    jobs: DurableJobs

    @classmethod
    def open(cls, settings: Settings) -> Service:
        """Open what the settings name; tables are brought up to date, the master key is made on the first start."""
        settings.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        db = Database(settings.database())
        db.migrate()
        blobs = Blobs(settings.blob_url, settings.data_dir / "blobs", settings.scratch)
        return cls(settings, db, blobs, MasterKey.open(settings, db), DurableJobs(db, settings.jobs_database()))

    def close(self) -> None:
        """Give connections back."""
        self.db.close()
