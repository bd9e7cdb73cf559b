"""What a budget costs: every kind of output is made of one scene, and its files are read back."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from engine.flows.embed.profiles import Auto, EmbedConfig
from engine.formats import encode_model
from engine.lab.evaluate.bench import marking
from engine.model import GaussianModel
from tests.watermark.ball import ball_model


def test_files_of_every_output_are_made_and_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    original, made = ball_model(200), list[EmbedConfig | Auto]()

    def moved(by: float) -> GaussianModel:
        return original.with_(sh=original.sh + np.float32(by))

    def mark(scene: str, config: EmbedConfig | Auto, *, seed: int) -> SimpleNamespace:
        made.append(config)
        opened = SimpleNamespace(reference=moved(0.01))
        return SimpleNamespace(original=original, marked=moved(0.1), opened=opened, report={"gaussians_out": 200})

    zs = iter(range(999))
    for name, stand_in in {
        "mark_scene": mark,
        "read_attacked": lambda *_: SimpleNamespace(claim=SimpleNamespace(z=next(zs))),
        "UNSEEN_SIDE": 48,
        "BUDGETS_DB": (40.0, 30.0),
    }.items():
        monkeypatch.setattr(marking, name, stand_in)
    rows = marking.measure_budgets("a/ball.ply", 0, "fast", "cpu")
    settings = [config.start if isinstance(config, Auto) else config for config in made]
    costs = [(c.prune.budget_db, c.output == "compact" and c.compact_db, c.prune.recover) for c in settings]
    both = [(db, recover) for db in (40.0, 30.0) for recover in (False, True)]
    pruned, compact = [(db, False, recover) for db, recover in both], [(None, db, recover) for db, recover in both]
    assert costs == [(None, False, False), (40.0, False, True), *pruned, *compact]
    assert [config.format for config in made if isinstance(config, Auto)] == ["sog"]
    assert [(row["wanted_db"], row["recover"]) for row in rows] == [(None, False), (40.0, True), *both, *both]
    assert [row["z_jpeg_10"] for row in rows] == list(range(0, 3 * len(rows), 3))
    for row in rows:
        assert row["sog_bytes"] == len(encode_model(moved(0.1), "sog"))
        assert row["psnr_pruned_unseen"] > row["ply_unseen"] + 15.0
        assert 20.0 < row["ply_unseen"] != row["sog_unseen"] > 20.0
