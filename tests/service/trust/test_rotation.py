"""Another master key: everything opens under it and nothing under the old one, wherever the change is cut off."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from pydantic import SecretStr

from engine.watermark.keys import OwnerKey
from service.db import Database, schema
from service.jobs.durable_jobs import Presence
from service.problems import Problem
from service.settings import Settings
from service.trust import api_keys, owner_keys, rotation, signing, webhook_secrets
from service.trust.audit_check import verify_log
from service.trust.master import MasterKey, MasterKeyError
from service.trust.rotation import rotate_master

SECRET = OwnerKey(bytes(range(32)))


@pytest.fixture
def filled(settings: Settings, db: Database, master: MasterKey) -> str:
    """An API key's token; an owner key, an erased one and a signing key are there, too."""
    signing.ensure_key(db, master)
    owner_keys.store(db, master, "acme", SECRET)
    webhook_secrets.add(db, master, "acme", "https://hooks.example/", "hooks.example", 1)
    gone = owner_keys.store(db, master, "acme", OwnerKey(bytes(range(1, 33))))
    owner_keys.delete(db, "acme", gone.id)
    return api_keys.issue(db, master, "acme", ["read"])


def all_opens(db: Database, master: MasterKey, token: str) -> None:
    (known,) = owner_keys.list_keys(db, "acme")
    assert owner_keys.open_key(db, master, "acme", known.id).secret == SECRET.secret
    with db.read() as connection:
        assert signing.sign(connection, master, b"{}")
        assert webhook_secrets.secret_of(master, connection.execute(schema.webhooks.select()).one()).startswith("whs_")
    assert api_keys.check(db, master, token).tenant == "acme"


def test_everything_opens_under_the_new_key_only(
    settings: Settings, db: Database, master: MasterKey, filled: str
) -> None:
    path = settings.data_dir / "master.key"
    before = path.read_text()
    assert rotate_master(settings, db, master) == 3
    assert path.read_text() != before
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert sorted(each.name for each in settings.data_dir.glob("master*")) == ["master.key"]
    new = MasterKey.open(settings, db)
    all_opens(db, new, filled)
    (known,) = owner_keys.list_keys(db, "acme")
    with pytest.raises(Problem, match="altered"):
        owner_keys.open_key(db, master, "acme", known.id)
    path.write_text(before)
    with pytest.raises(MasterKeyError, match="not the one"):
        MasterKey.open(settings, db)
    assert verify_log(db).ok


def test_keys_of_every_age_are_known_after_two_changes(
    settings: Settings, db: Database, master: MasterKey, filled: str
) -> None:
    rotate_master(settings, db, master)
    second = MasterKey.open(settings, db)
    between = api_keys.issue(db, second, "acme", ["read"])
    rotate_master(settings, db, second)
    third = MasterKey.open(settings, db)
    for token in (filled, between, api_keys.issue(db, third, "acme", ["read"])):
        all_opens(db, third, token)
    with pytest.raises(Problem, match="not valid"):
        api_keys.check(db, third, filled[:-1] + ("0" if filled[-1] != "0" else "1"))


@pytest.mark.parametrize("moment", ["before the database", "after the database"])
def test_a_change_that_is_cut_off(
    settings: Settings, db: Database, master: MasterKey, filled: str, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    def die(*_: object) -> Path:
        raise KeyboardInterrupt

    if moment == "before the database":
        monkeypatch.setattr(rotation, "_reseal", die)
    else:
        monkeypatch.setattr(Path, "replace", lambda self, to: die() if self.suffix == ".new" else self.rename(to))
    with pytest.raises(KeyboardInterrupt):
        rotate_master(settings, db, master)
    monkeypatch.undo()
    all_opens(db, MasterKey.open(settings, db), filled)
    all_opens(db, MasterKey.open(settings, db), filled)


def test_not_while_a_worker_lives(settings: Settings, db: Database, master: MasterKey, filled: str) -> None:
    Presence(db).beat("w")
    with pytest.raises(Problem, match="stop the service"):
        rotate_master(settings, db, master)
    all_opens(db, MasterKey.open(settings, db), filled)
    Presence(db).leave("w")
    assert rotate_master(settings, db, master) == 3


def test_a_key_that_comes_by_setting(
    settings: Settings, db: Database, master: MasterKey, filled: str, tmp_path: Path
) -> None:
    old = (settings.data_dir / "master.key").read_text()
    by_setting = settings.model_copy(update={"master_key": SecretStr(old)})
    with pytest.raises(Problem, match="in a file"):
        rotate_master(by_setting, db, master)
    file = tmp_path / "new"
    file.write_text("ab" * 32)
    rotate_master(by_setting, db, master, file)
    all_opens(db, MasterKey.open(settings.model_copy(update={"master_key": SecretStr("ab" * 32)}), db), filled)
    with pytest.raises(MasterKeyError, match="not the one"):
        MasterKey.open(by_setting, db)
