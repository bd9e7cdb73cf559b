"""The benchmark: every attack of `engine.lab.sim.suite` on what a method has marked, ours or anybody's.

About 10 minutes of processor time a scene of 100,000 Gaussians, method and key. Quick: four attacks, one picture.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from engine.lab.evaluate.bench.attacks import other_views, to_8_bit
from engine.lab.evaluate.benchmark.methods import BITS, LEAST_MATCHES, OURS, Subject, mark_subject, scenes_and_methods
from engine.lab.evaluate.marked_subjects import picture_of
from engine.lab.evaluate.study import Bar, Cell, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import distinct, grouped, listed, picked
from engine.lab.sim.attack_cost import CHEAP_DB, Cost, image_cost, model_cost
from engine.lab.sim.suite import SUITE, WITHOUT_COST, Trial, apply_chain
from engine.model import Camera, GaussianModel
from engine.numerics.image_metrics import psnr, ssim
from engine.raster import render
from engine.watermark.statistics import log10_binomial_tail

__all__ = ["STUDY", "attack", "judge"]

VIEWS, SIDE = 6, 800
"""Views that neither the method nor an attack was tuned on, and their pixels a side."""
PICTURES = 2
"""Of these views, how many are attacked; a row has the worse one."""
OF_VIEWS = 0xBE7C
UNCHANGED_DB = 99.0
"""Stands for this PSNR and all above, infinity included."""
QUICK = ("none", "prune random 20 %", "JPEG 10", "noise 0.1")
OUTCOMES = ("removed", "ruined", "held")
"""The claim is lost though the look is kept; lost with it; kept."""


def attack(path: str, method: str, seed: int, quick: bool) -> list[Row]:
    """Mark a scene and attack it; ``what`` of a row is "embedding", "attack" or "false".

    A row "attack" has the bits read ``right`` (None: the method reads no such thing), whether that is a claim, and by
    its cost (see `engine.lab.sim.attack_cost`) the outcome, one of `OUTCOMES`. Rows "false" are of suspects that do
    not carry the mark: the unmarked scene, and the one that the next seed's owner has marked.
    """
    subject = mark_subject(method, path, seed)
    views = other_views(subject.original, VIEWS, SIDE, (seed, OF_VIEWS))[: 2 if quick else None]
    pairs = [(render(subject.original, camera), render(subject.marked, camera)) for camera in views]
    fidelity = {"psnr": min(psnr(a, b) for a, b in pairs), "ssim": min(ssim(a, b) for a, b in pairs)}
    rows: list[Row] = [{"what": "embedding", "seconds": subject.seconds, **fidelity}]
    pictures = views[: 1 if quick else PICTURES]
    for trial in SUITE:
        if quick and trial.label not in QUICK:
            continue
        if trial.kind == "image":
            tried = [_on_picture(subject, trial, camera, seed) for camera in pictures]
        else:
            tried = [_on_model(subject, trial, seed)]
        worst = min(tried, key=lambda row: (bool(row["claimed"]), row["right"] or 0))
        rows.append({"what": "attack", "attack": trial.label, "on": trial.kind, "source": trial.source, **worst})
    rows += _false(subject, mark_subject(method, path, seed + 1).marked, views[0])
    about: Row = {"scene": Path(path).name, "seed": seed}
    about |= {"method": subject.method.name, "informed": subject.method.informed}
    return [{**about, **row} for row in rows]


def _on_model(subject: Subject, trial: Trial, seed: int) -> Row:
    suspect = apply_chain(subject.marked, trial, seed)
    found = subject.read_model(suspect)
    judged = suspect
    if any(name in WITHOUT_COST for name, _ in trial.chain):
        judged = apply_chain(subject.marked, trial, seed, skip=WITHOUT_COST)
    return judge(found, model_cost(subject.marked, judged, seed=seed))


def _on_picture(subject: Subject, trial: Trial, camera: Camera, seed: int) -> Row:
    picture = picture_of(subject.marked, camera)
    found = subject.read_picture(to_8_bit(apply_chain(picture, trial, seed)), camera)
    judged = to_8_bit(apply_chain(picture, trial, seed, skip=WITHOUT_COST))
    return judge(found, image_cost(picture, judged))


def judge(found: tuple[int, bool, float | None] | None, cost: Cost) -> Row:
    """What was read, and what it cost the attacker."""
    look = min(cost.psnr if cost.covered_psnr is None else max(cost.psnr, cost.covered_psnr), UNCHANGED_DB)
    row: Row = {"right": None, "claimed": None, "z": None, "psnr": look, "coverage": cost.coverage, "outcome": None}
    if found is None:
        return row
    right, claimed, z = found
    outcome = "held" if claimed else "removed" if look >= CHEAP_DB else "ruined"
    return row | {"right": right, "claimed": claimed, "z": z, "outcome": outcome}


def _false(subject: Subject, foreign: GaussianModel, camera: Camera) -> list[Row]:
    rows: list[Row] = []
    for name, model in {"unmarked": subject.original, "another owner's": foreign}.items():
        for on in ("model", "image"):
            picture = picture_of(model, camera) if on == "image" else None
            found = subject.read_model(model) if picture is None else subject.read_picture(picture, camera)
            if found is not None:
                rows.append({"what": "false", "on": on, "suspect": name, "right": found[0], "claimed": found[1]})
    return rows


def _cells(options: Options) -> list[Cell]:
    return [
        Cell.of(f"{name}-{seed}", attack, **which, seed=seed, quick=options.quick)
        for name, which in scenes_and_methods(options)
        for seed in range(options.seed, options.seed + (options.trials or 1))
    ]


def _report(rows: list[Row], options: Options) -> Report:
    attacks, false, marked = (picked(rows, what=what) for what in ("attack", "false", "embedding"))
    methods = {row["method"]: "informed" if row["informed"] else "blind" for row in rows}
    by_attack, first, bars = grouped(attacks, "attack", "on"), next(iter(methods)), []
    for method, own in grouped(false, "method").items():
        claims = [f"{row['suspect']} {row['on']}" for row in own if row["claimed"]]
        bars.append(Bar.without(f"{method}: claims without a mark", "0", f"{len(claims)} of {len(own)}", claims))
    if OURS in methods:
        own = picked(attacks, method=OURS)
        lost = distinct(picked(own, outcome="removed"), "attack")
        what = f"ours: attacks that take the claim and keep {CHEAP_DB:g} dB"
        bars.append(Bar.without(what, "none", f"{len(lost)} of {len(by_attack)}", lost))
    lines = [
        {"attack": name, "on": on} | {method: _entry(picked(own, method=method)) for method in methods}
        for (name, on), own in sorted(by_attack.items(), key=lambda pair: _rank(picked(pair[1], method=first)))
    ]
    outcomes = {
        method: {outcome: len(picked(attacks, method=method, outcome=outcome)) for outcome in OUTCOMES}
        for method in methods
    }
    totals = [
        {
            "method": method,
            "reading": reading,
            **outcomes[method],
            "cannot read": len(picked(attacks, method=method, outcome=None)),
            "bits, mean": _share(picked(attacks, method=method)),
            "PSNR, worst view": f"{min(row['psnr'] for row in picked(marked, method=method)):.2f}",
            "SSIM": f"{min(row['ssim'] for row in picked(marked, method=method)):.5f}",
            "seconds": f"{np.median([row['seconds'] for row in picked(marked, method=method)]):.1f}",
        }
        for method, reading in methods.items()
    ]
    text = [
        "An informed reader compares with the unmarked original; a blind one solves a harder problem.",
        f"Where a method does not decide, {LEAST_MATCHES} of {BITS} bits are a claim, which fair bits reach with "
        f"probability {10 ** log10_binomial_tail(LEAST_MATCHES, BITS):.1g}. Removed: the claim is lost, and "
        f"{CHEAP_DB:g} dB of the look are left; ruined: both are lost. Pictures come with their cameras.",
    ]
    return Report(
        bars,
        [Section("Methods", text, [listed(totals)]), Section("Attacks, failing first", tables=[listed(lines)])],
        summary={"attacks": len(by_attack), "outcomes": outcomes},
    )


def _share(rows: Sequence[Row]) -> str:
    right = [row["right"] for row in rows if row["right"] is not None]
    return f"{100 * np.mean(right) / BITS:.1f} %" if right else ""


def _entry(rows: Sequence[Row]) -> str:
    """Outcomes by how bad they are, bits, and the look that is left."""
    told = [outcome for outcome in OUTCOMES if picked(rows, outcome=outcome)]
    return f"{', '.join(told)}, {_share(rows)} at {min(row['psnr'] for row in rows):.1f} dB" if told else "cannot read"


def _rank(rows: Sequence[Row]) -> tuple[int, float]:
    """Failures first: removed, ruined, held, not read; then the fewest bits."""
    worst = min((OUTCOMES.index(row["outcome"]) for row in rows if row["outcome"]), default=len(OUTCOMES))
    return worst, min((row["right"] or 0 for row in rows), default=0)


STUDY = Study(
    "benchmark",
    "Benchmark of watermarks for 3D Gaussian Splatting",
    "What do attacks leave of a method's mark, and what do they cost?",
    _cells,
    _report,
    frozenset({"quick", "methods", "trials"}),
)
