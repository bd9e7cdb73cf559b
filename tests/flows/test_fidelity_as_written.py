"""What `embed` promises is what the delivered file shows, once its format has rounded it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.compress.pruning import PruneConfig
from engine.flows.embed.profiles import profile
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import open_record
from engine.flows.views.view_set import SeenView
from engine.formats import read_model, write_model
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.usecases.mark import MarkAnswer, MarkOutput, MarkRequest, mark
from engine.watermark.keys import OwnerKey
from tests.scenes import sparse_plant

KEY = OwnerKey(bytes(range(32)))


def marked(folder: Path, kind: str, budget: float | None = None) -> MarkAnswer:
    """A plant that looks different from every side, marked into a file of this kind."""
    model = read_model(sparse_plant("ply")).model
    rest = np.random.default_rng(3).normal(0.0, 0.4, (len(model), 3, 3))
    write_model(model.with_(sh=np.concatenate([model.sh, rest], axis=1)), folder / "scene.ply")
    config = profile("fast", landmark_views=0, prune=PruneConfig(budget_db=budget, recover=False))
    output = {"": MarkOutput(folder / f"marked.{kind}", folder / "marked.record")}
    terms = MarkTerms(config=config)
    request = MarkRequest(model=folder / "scene.ply", key=KEY, outputs=output, terms=terms, format=kind)
    (made,) = mark(request, lambda *_: None)
    return made


def test_what_a_format_drops_is_in_the_fidelity_told(tmp_path: Path) -> None:
    made = marked(tmp_path, "splat")
    original, file = read_model(tmp_path / "scene.ply").model, read_model(tmp_path / "marked.splat").model
    opened = open_record((tmp_path / "marked.record").read_bytes(), KEY)
    seen = [psnr(render(original, camera), render(file, camera)) for camera in opened.cameras]
    told = made.report.psnr_as_written
    assert min(abs(told - each) for each in seen) < 1e-3, "that of one of the key views"
    assert told < made.report.embedding.psnr_total_worst_view - 10, "the harmonics are gone"


def test_what_was_pruned_is_in_the_fidelity_told(tmp_path: Path) -> None:
    """In the view that shows most of all losses; another one shows most of the mark alone."""
    made = marked(tmp_path, "spz", budget=30.0)
    original, file = read_model(tmp_path / "scene.ply").model, read_model(tmp_path / "marked.spz").model
    opened = open_record((tmp_path / "marked.record").read_bytes(), KEY)
    before, after = (
        [psnr(render(original, camera), render(model, camera)) for camera in opened.cameras]
        for model in (made.embedding.model, file)
    )
    assert made.report.embedding.psnr_total_worst_view == pytest.approx(min(before), abs=1e-3)
    assert made.report.psnr_as_written == pytest.approx(after[int(np.argmin(before))], abs=1e-3)


def test_a_file_that_holds_all_is_not_drawn_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SeenView, "psnr_of", lambda *_: pytest.fail("drawn again"))
    report = marked(tmp_path, "ply").report
    assert report.psnr_as_written == report.embedding.psnr_total_worst_view
