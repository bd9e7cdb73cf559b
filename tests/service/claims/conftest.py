"""A registry with one asset, and claims about it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.claims.issuing import IssuedClaim, issue_claim
from service.db import Database
from service.db.schema import assets
from service.settings import Settings
from service.trust import signing
from service.trust.commitments import commit_asset
from service.trust.master import MasterKey
from tests.service.claims.cases import DRAWN, PICTURES, asset_row, reply, verify_job


class Registry:
    """Tables, keys, and the asset "as_1" of the tenant "acme"."""

    def __init__(self, folder: Path) -> None:
        settings = Settings(data_dir=folder)
        self.db = Database(settings.database())
        self.db.migrate()
        self.master = MasterKey.open(settings, self.db)
        signing.ensure_key(self.db, self.master)
        self.register()

    @property
    def jwks(self) -> dict[str, Any]:
        return signing.jwks(self.db)

    def register(self, **changes: Any) -> None:
        with self.db.write() as connection:
            connection.execute(assets.insert().values(asset_row(**changes)))
            commit_asset(connection, asset_row(**changes), DRAWN)

    def issue(self, found: dict[str, Any] | None = None, job: str = "job_1", tenant: str = "acme") -> IssuedClaim:
        with self.db.write() as connection:
            pictures = {name: hashlib.sha256(data).hexdigest() for name, data in PICTURES.items()}
            return issue_claim(
                connection, self.master, verify_job(job, tenant), (found or reply()) | {"kept": pictures}
            )

    def sign(self, payload: bytes) -> str:
        with self.db.read() as connection:
            return signing.sign(connection, self.master, payload)


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[Registry]:
    made = Registry(tmp_path)
    yield made
    made.db.close()
