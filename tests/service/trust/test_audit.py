"""The log: every entry provable, whichever processes append at the same time or die meanwhile."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import sqlalchemy as sa

from engine.records import merkle
from service.db import Database
from service.db.schema import audit as table
from service.trust import audit
from service.trust.audit_check import verify_log
from service.trust.canonical import canonical
from tests.reference import merkle as twin

REPOSITORY = Path(__file__).parents[3]


def appender(db: Database, name: str, count: int) -> subprocess.Popen[bytes]:
    program = [sys.executable, "-m", "tests.service.trust.appender", db.url, name, str(count)]
    return subprocess.Popen(program, cwd=REPOSITORY, stdout=subprocess.PIPE, bufsize=0)


def fill(db: Database, count: int) -> list[audit.Entry]:
    entries = []
    for number in range(count):
        with db.write() as connection:
            entries.append(audit.append(connection, "acme", "test", {"number": number}, f"s{number % 3}"))
    return entries


def test_entries_are_chained_and_their_tree_is_the_twins(db: Database) -> None:
    entries = fill(db, 19)
    previous = audit.NO_PREVIOUS
    for index, entry in enumerate(entries):
        assert (entry.index, entry.previous) == (index, previous)
        previous = entry.hash
    leaves = [canonical(entry.to_json()) for entry in entries]
    with db.read() as connection:
        assert audit.size(connection) == 19
        for size in range(20):
            assert audit.root(connection, size) == twin.tree_hash(leaves[:size]).hex()
        for index in range(19):
            proof = audit.inclusion_proof(connection, index, 19)
            assert proof == [step.hex() for step in twin.path(index, leaves)]
    assert verify_log(db).ok


def test_entries_are_found_by_what_they_are_about(db: Database) -> None:
    entries = fill(db, 7)
    with db.read() as connection:
        assert audit.find(connection, "test", "s1") == entries[1]  # the first of several
        assert audit.find(connection, "test", "s0") == entries[0]
        assert audit.find(connection, "test", "s9") is None
        assert audit.find(connection, "other", "s1") is None


def test_an_empty_log_has_the_empty_root(db: Database) -> None:
    with db.read() as connection:
        assert (audit.size(connection), audit.root(connection, 0)) == (0, merkle.EMPTY_ROOT.hex())
    assert verify_log(db).ok


def test_what_is_rolled_back_was_never_there(db: Database) -> None:
    fill(db, 3)
    with suppress(ZeroDivisionError), db.write() as connection:
        audit.append(connection, "acme", "test", {})
        raise ZeroDivisionError
    assert fill(db, 1)[0].index == 3
    assert verify_log(db).entries == 4


@pytest.mark.parametrize("payload", [{"x": float("nan")}, {"x": 2**60}, {"x": "\ud800"}, {"x": b"bytes"}])
def test_what_has_no_canonical_form_is_not_logged(db: Database, payload: dict[str, object]) -> None:
    with pytest.raises(ValueError), db.write() as connection:  # noqa: PT011
        audit.append(connection, "acme", "test", payload)
    assert verify_log(db).entries == 0


def test_processes_that_append_at_once_make_one_chain(db: Database) -> None:
    running = [appender(db, f"p{k}", 40) for k in range(3)]
    lines = [line for process in running for line in process.communicate(timeout=120)[0].decode().split("\n") if line]
    assert [process.returncode for process in running] == [0] * 3
    assert sorted(int(line.split()[0]) for line in lines) == list(range(120))
    report = verify_log(db)
    assert report.ok, report.text()
    assert report.entries == 120


def test_killed_appenders_lose_nothing_they_acknowledged(db: Database) -> None:
    acknowledged: dict[int, str] = {}
    for round_number in range(3):
        running = [appender(db, f"r{round_number}p{k}", 100_000) for k in range(2)]
        said: list[list[str]] = []
        for process in running:  # however fast the machine is, they are in the middle of their work
            assert process.stdout is not None
            said.append([process.stdout.readline().decode() for _ in range(5 + round_number)])
        for process in running:
            process.kill()
        for process, lines in zip(running, said, strict=True):
            # A line that was not written whole was not an acknowledgement.
            rest = process.communicate(timeout=60)[0].decode().split("\n")[:-1]
            for line in [*lines, *rest]:
                index, digest = line.split()
                assert acknowledged.setdefault(int(index), digest) == digest
    assert len(acknowledged) > 20
    with db.read() as connection:
        rows = connection.execute(sa.select(table.c.index, table.c.hash)).all()
    stored = {row[0]: row[1] for row in rows}
    assert not {index for index, digest in acknowledged.items() if stored.get(index) != digest}
    report = verify_log(db)
    assert report.ok, report.text()
    assert fill(db, 1)[0].index == report.entries
