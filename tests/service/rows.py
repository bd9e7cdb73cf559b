"""Rows of assets as a worker leaves them."""

from __future__ import annotations

from typing import Any

from service.blobs import Blobs
from service.db import Database
from service.db.schema import assets
from service.trust.commitments import commit_asset


def add_asset(db: Database, *, commit: bool = False, **values: Any) -> str:
    """Id of a new asset: its values, and "x" where none is given; `commit`: the log says so, too."""
    row = {column.name: "x" for column in assets.columns} | {"id": "as_1", "gaussians": 1, "report": "{}"} | values
    with db.write() as connection:
        connection.execute(assets.insert().values(row))
        if commit:
            commit_asset(connection, row)
    return str(row["id"])


def put(blobs: Blobs, content: bytes) -> str:
    """Digest of a new file in the store."""
    with blobs.new_file() as path:
        path.write_bytes(content)
        return blobs.put(path)
