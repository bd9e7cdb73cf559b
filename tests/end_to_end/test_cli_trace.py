"""Tracing through the command line: the buyers who put their copies together are named, the others are not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from engine.cli.app import run
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.formats import read_model, write_model
from engine.lab.sim.adversaries.collusion import collude
from engine.watermark.keys import OwnerKey
from tests.end_to_end.conftest import SCENE, ask

QUICK = profile("fast", views=4, view_size=256, landmark_views=0)


@pytest.fixture(scope="module")
def sold(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three copies and their records."""
    folder = tmp_path_factory.mktemp("sold")
    assert run(["keygen", str(folder / "owner.key")]) == 0
    key, loaded = OwnerKey.read(folder / "owner.key"), read_model(SCENE)
    for name in ("ann", "bob", "eve"):
        made = embed(loaded.model, key, original_sha256=loaded.sha256, bits=16, config=QUICK, copy=name)
        write_model(made.model, folder / f"{name}.ply")
        (folder / f"{name}.record").write_bytes(made.record.to_bytes(key))
    return folder


def test_both_colluders_are_named_and_nobody_else(sold: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ann, eve = (read_model(sold / f"{name}.ply").model for name in ("ann", "eve"))
    suspect = sold / "mixed.ply"
    write_model(collude(ann, "mean", np.random.default_rng(0), others=[eve]), suspect)
    code, report = ask(capsys, "trace", suspect, "--records", sold, "--key", sold / "owner.key")
    assert code == 0
    assert sorted(report["named"]) == ["ann", "eve"]
    assert [finding["copy"] for finding in report["findings"]][-1] == "bob"
    assert abs(report["findings"][-1]["z"]) < 5
    assert report["tries"] == 54  # three records, two routes (one of them read in two ways), three questions, two signs
    assert run(["trace", str(suspect), "--records", str(sold), "--key", str(sold / "owner.key")]) == 0
    said = capsys.readouterr().out
    assert "NAMED: " in said
    assert "below 10^-300" in said or "at most 1 in 10^" in said
    assert not re.search(r"\de[-+]?\d", " ".join(line.rpartition("  ")[0] for line in said.splitlines())), "an exponent"


@pytest.mark.long
def test_the_unmarked_original_names_nobody(sold: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, report = ask(capsys, "trace", SCENE, "--records", sold / "bob.record", "--key", sold / "owner.key")
    assert (code, report["named"]) == (3, [])


def test_wrong_uses_are_refused(sold: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    key = ("--key", str(sold / "owner.key"))
    assert run(["trace", str(SCENE), "--records", str(tmp_path), *key]) == 2
    assert "ends in .record" in capsys.readouterr().err
    twice = ("--records", str(sold / "ann.record")) * 2
    assert run(["trace", str(SCENE), *twice, *key]) == 2
    assert "given twice" in capsys.readouterr().err
    assert run(["trace", str(SCENE), str(SCENE), "--records", str(sold), *key]) == 2
    assert "one model at a time" in capsys.readouterr().err
