"""Make the golden time stamp: `python -m tests.data.draws.make_stamp`. Needs openssl; a new one has other bytes.

It draws for a plan of these terms and of an original with this digest, as a record and its claims have it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from engine.flows.records.draw import draw_request
from engine.records.timestamps import make_query

FOLDER = Path(__file__).parent
STAMP, AUTHORITY = FOLDER / "stamp.tsr", FOLDER / "authority.pem"
ORIGINAL, TERMS = "ab" * 32, "5e" * 32


def main() -> None:
    from tests.records.test_timestamps import Authority

    with tempfile.TemporaryDirectory() as folder:
        authority = Authority(Path(folder))
        request = draw_request(bytes.fromhex(ORIGINAL), bytes.fromhex(TERMS))
        STAMP.write_bytes(authority.reply(make_query(request)))
        AUTHORITY.write_bytes((Path(folder) / "ca.pem").read_bytes())


if __name__ == "__main__":
    main()
