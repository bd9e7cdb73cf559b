"""API keys: bound to a tenant and scopes, kept as a code only, alike in refusal."""

from __future__ import annotations

import pytest
import sqlalchemy as sa

from service.db import Database
from service.db.schema import api_keys as table
from service.db.schema import audit as log
from service.problems import Problem
from service.trust import api_keys
from service.trust.master import MasterKey


def test_a_token_names_its_caller(db: Database, master: MasterKey) -> None:
    token = api_keys.issue(db, master, "acme", ["verify", "read", "read"], "laptop")
    caller = api_keys.check(db, master, token)
    assert (caller.tenant, caller.scopes) == ("acme", {"verify", "read"})
    (known,) = api_keys.list_keys(db, "acme")
    assert (known.id, known.label, known.scopes, known.revoked_at) == (caller.key_id, "laptop", ("verify", "read"), "")
    assert api_keys.list_keys(db, "other") == []
    assert len(token) == len("mk_") + 16 + 1 + 64


def test_the_secret_is_nowhere_kept(db: Database, master: MasterKey) -> None:
    secret = api_keys.issue(db, master, "acme", ["read"]).split("_")[2]
    with db.read() as connection:
        everything = str([connection.execute(t.select()).all() for t in (table, log)])
    assert secret not in everything
    assert "read" in everything


def test_refusals_cannot_be_told_apart(db: Database, master: MasterKey) -> None:
    token = api_keys.issue(db, master, "acme", ["read"])
    gone = api_keys.issue(db, master, "acme", ["read"])
    api_keys.revoke(db, "acme", gone.split("_")[1])
    api_keys.revoke(db, "acme", gone.split("_")[1])  # twice is once
    end = "0" if token[-1] != "0" else "1"
    wrong = [gone, token[:-1] + end, f"mk_{'0' * 16}_{'0' * 64}", "", "mk_", token + "0", token.upper(), f" {token}"]
    said = set()
    for bad in wrong:
        with pytest.raises(Problem) as caught:
            api_keys.check(db, master, bad)
        said.add((caught.value.kind, caught.value.detail, str(caught.value.headers)))
    assert said == {("unauthorized", "this API key is not valid", "{'WWW-Authenticate': 'Bearer'}")}
    assert api_keys.check(db, master, token).tenant == "acme"
    other = MasterKey(bytes(range(32)))
    with pytest.raises(Problem):
        api_keys.check(db, other, token)


def test_a_code_belongs_to_one_key(db: Database, master: MasterKey) -> None:
    """Whoever can write to the table still cannot give a known secret to another key's id."""
    mine, theirs = (api_keys.issue(db, master, tenant, ["read"]) for tenant in ("me", "them"))
    _, my_id, my_secret = mine.split("_")
    _, their_id, _ = theirs.split("_")
    with db.write() as connection:
        code = connection.execute(sa.select(table.c.digest).where(table.c.id == my_id)).scalar_one()
        connection.execute(table.update().where(table.c.id == their_id).values(digest=code))
    with pytest.raises(Problem):
        api_keys.check(db, master, f"mk_{their_id}_{my_secret}")


def test_keys_of_others_cannot_be_revoked(db: Database, master: MasterKey) -> None:
    token = api_keys.issue(db, master, "acme", ["read"])
    for tenant, key_id in (("other", token.split("_")[1]), ("acme", "0" * 16)):
        with pytest.raises(Problem) as caught:
            api_keys.revoke(db, tenant, key_id)
        assert caught.value.kind == "not-found"
    assert api_keys.check(db, master, token)


@pytest.mark.parametrize("scopes", [[], ["write"], ["read", ""]])
def test_unknown_scopes_are_refused(db: Database, master: MasterKey, scopes: list[str]) -> None:
    with pytest.raises(Problem) as caught:
        api_keys.issue(db, master, "acme", scopes)
    assert caught.value.kind == "invalid-request"
    assert api_keys.list_keys(db, "acme") == []


def test_only_an_empty_service_gets_a_first_key(db: Database, master: MasterKey) -> None:
    first = api_keys.issue_first(db, master, "default")
    assert first is not None
    assert api_keys.check(db, master, first).scopes == {"admin"}
    assert api_keys.issue_first(db, master, "default") is None
