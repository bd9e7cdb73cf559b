"""A report: misses first, figures beside and inside, nothing fetched from elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from engine.lab.evaluate.figures import figure, label_line, styles
from engine.lab.evaluate.intervals import bootstrap, share_interval
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.study import Bar, Drawing, Options, Report, Row, Section, Study, Table


def curve() -> object:
    drawn, axes = figure()
    for style, power in zip(styles(), (1, 2, 3), strict=False):
        axes.plot(np.arange(5), np.arange(5) ** power, label=str(power), **style)
    label_line(axes, 10.0, "bar")
    axes.legend()
    return drawn


def report(rows: list[Row], options: Options) -> Report:
    drawings = [Drawing("curve", curve, "A curve.")]
    return Report(
        [Bar("good", "> 1", "2", True), Bar("unknown", "> 1", "-", None), Bar("bad <b>", "> 1", "0", False)],
        [Section("How", ["in words"], [Table(["a", "b"], [[1.23456, "x & y"]])], drawings)],
        answer=["It works."],
        summary={"n": len(rows), "nan": float("nan")},
    )


STUDY = Study("trial", "A trial", "Does it work?", lambda options: [], report)


def test_misses_come_first_and_the_page_stands_alone(tmp_path: Path) -> None:
    options = Options(("/somewhere/plant.splat",), quick=True)
    said = write_report(STUDY, [{"cell": "a", "z": 1.0}], options, tmp_path)
    assert [bar["what"] for bar in said["bars"]] == ["bad <b>", "unknown", "good"]
    page = (tmp_path / "report.html").read_text()
    assert page.index("bad &lt;b&gt;") < page.index("unknown") < page.index("good")
    assert "x &amp; y" in page
    assert "1.235" in page
    assert "quick run" in page
    assert "informed" in page
    assert "http" not in page.replace("http-equiv", "")
    assert "/somewhere" not in page
    assert (tmp_path / "figures" / "curve.svg").read_bytes().startswith(b"<?xml")
    assert (tmp_path / "figures" / "curve.png").read_bytes().startswith(b"\x89PNG")
    stored = json.loads((tmp_path / "results.json").read_text())
    assert stored["summary"] == {"n": 1, "nan": None}
    assert stored["rows"] == [{"cell": "a", "z": 1.0}]


def test_figures_are_the_same_bytes_every_time(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_report(STUDY, [], Options(("a",)), tmp_path / name)
    for file in ("figures/curve.svg", "figures/curve.png", "report.html"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_exact_intervals() -> None:
    low, high = share_interval(0, 100)
    assert low == 0.0
    assert high == pytest.approx(1 - 0.025 ** (1 / 100))
    low, high = share_interval(50, 100)
    assert (low, high) == (pytest.approx(0.3983, abs=1e-4), pytest.approx(0.6017, abs=1e-4))
    assert share_interval(7, 7)[1] == 1.0
    assert share_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match="8 hits of 7"):
        share_interval(8, 7)


def test_bootstrap_covers_the_mean() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for trial in range(200):
        low, high = bootstrap(rng.normal(3.0, 1.0, 40), draws=400, seed=trial)
        covered += low <= 3.0 <= high
    assert 0.88 <= covered / 200 <= 0.99
    assert bootstrap([2.0]) == (2.0, 2.0)
