"""A manifest in an uploaded file: no task looks at it, no verdict and no embedding changes by it."""

from __future__ import annotations

from pathlib import Path

import pytest

from engine.credentials.manifest import embedded_manifest
from engine.credentials.signer import Signer, make_trial_signer
from engine.credentials.signing import sign_into
from service.work.tasks import TASKS
from tests.scenes import sparse_plant
from tests.service.work.conftest import Ask, Marked, silent

TIMED = {"seconds", "seconds_by_stage"}


@pytest.fixture(scope="module")
def signer() -> Signer:
    return make_trial_signer("Thief", 1)[0]


@pytest.fixture
def forged(marked: Marked, signer: Signer, tmp_path: Path) -> Path:
    """The unmarked scene, with a manifest that names the record of a marked copy."""
    (tmp_path / "plain.sog").write_bytes(sparse_plant("sog"))
    sign_into(tmp_path / "plain.sog", tmp_path / "forged.sog", marked.reply["record_id"], signer)
    return tmp_path / "forged.sog"


@pytest.mark.long
def test_a_verdict_is_the_same_with_it(verify: Ask, forged: Path) -> None:
    plain, with_it = (verify(model=str(path)) for path in (forged.with_name("plain.sog"), forged))
    assert with_it["claim"]["verdict"] != "marked"
    for name in set(plain) - TIMED:
        assert with_it[name] == plain[name], name


def test_a_look_says_nothing_of_it(inspect: Ask, forged: Path) -> None:
    plain, with_it = inspect(forged.with_name("plain.sog")), inspect(forged)
    assert {name for name in plain if plain[name] != with_it[name]} == {"bytes", "sha256"}
    assert set(with_it) == set(plain)


def test_it_does_not_pass_through(forged: Path, tmp_path: Path) -> None:
    """What is delivered is written anew: no manifest is carried over."""
    reply = TASKS["convert"]({"model": str(forged), "format": "sog"}, tmp_path, silent)
    assert embedded_manifest((tmp_path / reply["files"]["model"]).read_bytes(), "x") is None
