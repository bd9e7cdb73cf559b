"""The master key: made once, kept safe, and never mistaken for another."""

from __future__ import annotations

import multiprocessing
import os
import stat
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from hypothesis import given
from hypothesis import strategies as st
from pydantic import SecretStr

from service.db import Database
from service.problems import Problem
from service.settings import Settings
from service.trust.master import MasterKey, MasterKeyError, bind

KEY = MasterKey(bytes(range(32)))


def open_at_once(settings: Settings, start: object, answers: object) -> None:
    db = Database(settings.database())
    start.wait()  # type: ignore[attr-defined]
    try:
        answers.put(MasterKey.open(settings, db).check_value)  # type: ignore[attr-defined]
    except Exception as error:
        answers.put(repr(error))  # type: ignore[attr-defined]


def test_first_start_makes_a_key_that_only_the_owner_can_read(settings: Settings, db: Database) -> None:
    key = MasterKey.open(settings, db)
    path = settings.data_dir / "master.key"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert len(bytes.fromhex(path.read_text())) == 32
    assert [name for name in os.listdir(settings.data_dir) if name.startswith("master")] == ["master.key"]
    again = MasterKey.open(settings, db)
    assert again.unseal(key.seal(b"x", b"y"), b"y") == b"x"
    given_by_setting = settings.model_copy(update={"master_key": SecretStr(path.read_text())})
    assert MasterKey.open(given_by_setting, db).check_value == key.check_value


def test_processes_that_start_at_once_agree(settings: Settings, db: Database) -> None:
    spawn = multiprocessing.get_context("spawn")
    start, answers = spawn.Barrier(4), spawn.Queue()
    workers = [spawn.Process(target=open_at_once, args=(settings, start, answers)) for _ in range(4)]
    for worker in workers:
        worker.start()
    found = {answers.get(timeout=60) for _ in workers}
    for worker in workers:
        worker.join()
    assert found == {MasterKey.open(settings, db).check_value}


def test_a_lost_file_is_not_replaced(settings: Settings, db: Database) -> None:
    MasterKey.open(settings, db)
    (settings.data_dir / "master.key").unlink()
    with pytest.raises(MasterKeyError, match="is missing, and this database was sealed"):
        MasterKey.open(settings, db)
    assert not (settings.data_dir / "master.key").exists()


def test_another_key_does_not_open_the_database(settings: Settings, db: Database) -> None:
    MasterKey.open(settings, db)
    (settings.data_dir / "master.key").write_text("ab" * 32)
    with pytest.raises(MasterKeyError, match="not the one that sealed this database"):
        MasterKey.open(settings, db)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o700 | 0o044])
def test_a_file_that_others_may_read_is_refused(settings: Settings, db: Database, mode: int) -> None:
    MasterKey.open(settings, db)
    (settings.data_dir / "master.key").chmod(mode)
    with pytest.raises(MasterKeyError, match="chmod 600"):
        MasterKey.open(settings, db)


@pytest.mark.parametrize("text", ["", "ab" * 31, "ab" * 33, "zz" * 32, "\xff" * 64])
def test_a_file_that_holds_no_key_is_refused_without_repeating_it(settings: Settings, db: Database, text: str) -> None:
    path = settings.data_dir / "master.key"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(MasterKeyError, match="must hold 64 hexadecimal digits") as caught:
        MasterKey.open(settings, db)
    assert "abab" not in str(caught.value)


def test_an_unreadable_place_is_said(tmp_path: Path, db: Database) -> None:
    with pytest.raises(MasterKeyError, match="No such file or directory"):
        MasterKey.open(Settings(data_dir=tmp_path / "nowhere"), db)


def test_a_start_that_died_in_the_middle_leaves_the_next_one_free(settings: Settings, db: Database) -> None:
    (settings.data_dir / "master.part").write_text("half")
    MasterKey.open(settings, db)
    assert not (settings.data_dir / "master.part").exists()


@given(st.binary(max_size=100), st.binary(max_size=20), st.data())
def test_seals_hold_and_tell_every_change(plain: bytes, aad: bytes, data: st.DataObject) -> None:
    sealed = KEY.seal(plain, aad)
    assert KEY.unseal(sealed, aad) == plain
    spot = data.draw(st.integers(0, len(sealed) - 1))
    bent = sealed[:spot] + bytes([sealed[spot] ^ 1 << data.draw(st.integers(0, 7))]) + sealed[spot + 1 :]
    for altered, where in ((bent, aad), (sealed, aad + b"x"), (sealed[:-1], aad), (b"", aad)):
        with pytest.raises(Problem, match="altered"):
            KEY.unseal(altered, where)
    with pytest.raises(Problem):
        MasterKey(bytes(32)).unseal(sealed, aad)


def test_two_seals_of_one_secret_differ() -> None:
    assert KEY.seal(b"x", b"") != KEY.seal(b"x", b"")


def test_the_seal_is_aes_256_gcm_under_a_key_of_its_own() -> None:
    sealed = KEY.seal(b"secret", b"")
    with pytest.raises(InvalidTag):
        AESGCM(bytes(range(32))).decrypt(sealed[:12], sealed[12:], b"")  # not the master key itself


@given(st.lists(st.text(max_size=5), max_size=4), st.lists(st.text(max_size=5), max_size=4))
def test_no_two_lists_of_parts_are_bound_alike(a: list[str], b: list[str]) -> None:
    assert (bind("p", *a) == bind("p", *b)) == (a == b)


def test_codes_of_two_purposes_differ() -> None:
    assert KEY.mac("a", "x") != KEY.mac("b", "x")
    assert KEY.mac("a", "x", "y") != KEY.mac("a", "xy")
    assert "010203" not in repr(KEY)
