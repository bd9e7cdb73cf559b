"""Appends to the audit log until it is killed, and says each entry that was committed. Run as a program."""

from __future__ import annotations

import os
import sys

from service.db import Database
from service.trust import audit


def main(url: str, name: str, count: int) -> None:
    """Append `count` entries; each acknowledged index is one line."""
    db = Database(url)
    for number in range(count):
        with db.write() as connection:
            entry = audit.append(connection, name, "test", {"number": number}, f"{name}-{number}")
        os.write(1, f"{entry.index} {entry.hash}\n".encode())


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
