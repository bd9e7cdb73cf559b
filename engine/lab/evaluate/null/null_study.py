"""Suite 4: calibration. Does the measured rate of false claims keep below the stated bound, whatever is tried?

Full: about 20 suspects with a million wrong keys each, 10,000 other recipients, power from thinned models and from
bad pictures, a detector that must fail, and forged originals: about 10 minutes a scene of 100k Gaussians on 2
cores. Quick: the same with 100,000 keys, few trials, small views.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import norm

from engine.lab.evaluate.figures import FAINT, INK, Figure, figure, label_line, spread_curve, styles
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.null import null_cells
from engine.lab.evaluate.null.null_rates import CLAIM, LOG10_THRESHOLDS, Rates, add_up, exceeding, share_claimed
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import distinct, grouped, listed, picked, table
from engine.watermark.statistics import z_threshold

__all__ = ["STUDY", "draw_false_claims", "draw_power", "draw_roc"]

SHARES = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0005, 0.00025)
PICTURES = (1, 2, 4, 8, 16)
WANTED_KEYS = 1_000_000
GROUPS = {
    "found": "suspects as found",
    "crafted": "suspects made to deceive",
    "copies": "other recipients, real keys",
    "other scene": "other scenes",
}


def cells(options: Options) -> list[Cell]:
    """One cell for each kind of suspect and scene; each pair of neighbouring scenes once."""
    return [cell for number, path in enumerate(options.scenes) for cell in _of_scene(number, path, options)]


def _of_scene(number: int, path: str, options: Options) -> list[Cell]:
    quick, made = options.quick, list[Cell]()
    keys = 100_000 if quick else 1_000_000
    shares, counts = list(SHARES[2:5] if quick else SHARES), list(PICTURES[:2] if quick else PICTURES)

    def add(name: str, work: Callable[..., list[Row]], /, **arguments: Any) -> None:
        made.append(Cell.of(f"{number}-{name}", work, path=path, quick=quick, seed=options.seed, **arguments))

    for name in null_cells.FOUND:
        add(f"found-{name}", null_cells.try_found, name=name, keys=keys)
    add("crafted", null_cells.try_crafted, keys=keys)
    add("copies", null_cells.try_copies, copies=200 if quick else 10_000)
    add("wrong-detector", null_cells.rebuild_reference, keys=5 if quick else 100)
    add("forged", null_cells.forge_original)
    add("gaussians", null_cells.few_gaussians, shares=shares, trials=2 if quick else 20)
    add("pictures", null_cells.few_pictures, counts=counts, draws=20 if quick else 200)
    if len(options.scenes) > 1:
        add("pair", null_cells.try_pairs, other=options.scenes[(number + 1) % len(options.scenes)])
    return made


def report(rows: list[Row], options: Options) -> Report:
    """Bars on false claims first, then the counts, the counterexamples and the power."""
    tried, forged, wrong = (picked(rows, what=what) for what in ("null", "forged", "wrong detector"))
    power = picked(rows, what="power")
    rates, largest = add_up(tried, "all"), max(row["z_largest"] for row in tried)
    answer = (
        f"{rates.keys:,} keys, unrelated to the suspects they were tested on, made {rates.hits[-1]} claims at 1e-9; "
        f"the largest z was {largest:.2f}, a claim needs 6.44."
    )
    measured = zip(LOG10_THRESHOLDS, rates.shares, strict=True)
    return Report(
        [*_null_bars(tried, forged, rates), _counter_bar(wrong)],
        [_null_section(tried, wrong, forged), _power_section(power)],
        answer=[answer],
        summary={
            "wrong_keys": rates.keys,
            "claims": rates.hits[-1],
            "largest_z": largest,
            "measured": {f"{10.0**log10:.3g}": float(share) for log10, share in measured},
        },
    )


def _null_bars(tried: Sequence[Row], forged: Sequence[Row], rates: Rates) -> list[Bar]:
    thresholds = len(LOG10_THRESHOLDS)
    above = [f"above at 1e{b:g}" for b, share in zip(LOG10_THRESHOLDS, rates.shares, strict=True) if share > 10.0**b]
    each = [f"{row['scene']}, {row['suspect']}, {row['route']}" for row in tried if exceeding(add_up([row], "one"))]
    clean = [row for row in tried if not row["carries"]] + [{**row, "suspect": "forged original"} for row in forged]
    claimed = [row["suspect"] for row in picked(clean, verdict="marked")]
    low, high = share_interval(len(claimed), len(clean))
    all_keys = f"{rates.hits[-1]} of {rates.keys:,} (95 %: at most {rates.intervals[-1, 1]:.2g})"
    below = f"{thresholds - len(above)} of {thresholds}"
    records = f"{len(claimed)} of {len(clean)} (95 %: {100 * low:.1f} to {100 * high:.1f} %)"
    together = "measured rate at or below the bound, all keys together"
    beyond = "measured rate of each suspect not above the bound beyond chance (exact, 95 %, thresholds counted)"
    hostile = "records that claim an unmarked, foreign, crafted or forged suspect"
    return [
        Bar("claims at 1e-9 by wrong keys", "0", all_keys, rates.hits[-1] == 0),
        Bar.without(together, f"at all {thresholds} thresholds", below, above),
        Bar.without(beyond, "every suspect", f"{len(tried) - len(each)} of {len(tried)}", each),
        Bar.without(hostile, "0", records, claimed),
        Bar("wrong keys tried", f">= {WANTED_KEYS:,}", f"{rates.keys:,}", rates.keys >= WANTED_KEYS),
    ]


def _counter_bar(wrong: Sequence[Row]) -> Bar:
    claims, keys = sum(row["claims"] for row in wrong), sum(row["keys"] for row in wrong)
    least = min((row["z_least"] for row in wrong), default=0.0)
    return Bar(
        "a detector with the classic mistake is caught by this test",
        "claims by wrong keys",
        f"{claims} of {keys} wrong keys claim, least z {least:.0f}",
        claims > 0 if wrong else None,
    )


def _null_section(tried: Sequence[Row], wrong: Sequence[Row], forged: Sequence[Row]) -> Section:
    groups = [add_up(own, name) for group, name in GROUPS.items() if (own := picked(tried, group=group))]
    title = f"{sum(group.keys for group in groups):,} wrong keys: no claim, and always below the bound"
    if any(group.hits[-1] for group in groups):
        title = "Wrong keys claim: the bound is broken"
    elif any(exceeding(group) for group in groups):
        title = "Measured false claims lie above the bound"
    text = (
        "Each key draws chips of its own for the true reference and the very same evidence. For such keys the theorem "
        "allows at most exp(-z²/2), whatever the suspect is; real evidence of thousands of chips comes close to the "
        "normal tail below it. The mistaken detector rebuilds its reference as suspect minus own mark, and finds "
        "every key in everything. A forged original is an owner's marked model minus a mark of the thief's own, "
        f"registered by the right program: {len(forged)} tried, "
        f"largest z {max((row['z'] for row in forged), default=0.0):.2f}."
    )

    def share_at(log10: float) -> Callable[[Row], str]:
        return lambda row: f"{row['hits'][LOG10_THRESHOLDS.index(log10)] / max(row['keys'], 1):.2g}"

    shown = table(
        sorted(tried, key=lambda row: -row["z_largest"]),
        "scene",
        "suspect",
        "route",
        ("keys", "{keys:,}"),
        ("largest z", "z_largest"),
        ("mean", "z_mean"),
        ("std", "z_std"),
        ("at 0.1", share_at(-1.0)),
        ("at 1e-3", share_at(-3.0)),
        ("at 1e-5", share_at(-5.0)),
        ("claims", lambda row: row["hits"][-1]),
        (
            "this record's own z and answer",
            lambda row: f"{row['z_own']:.2f}: {row['verdict']}" + (" (carries it)" if row["carries"] else ""),
        ),
        title="Largest z first",
    )
    drawing = Drawing(
        "false-claims",
        partial(draw_false_claims, groups, add_up(wrong, "wrong detector"), title),
        "Share of wrong keys that reach each stated bound. Where nothing is drawn, no key reached it.",
    )
    return Section("False claims", [text], [shown], [drawing])


def _power_section(power: Sequence[Row]) -> Section:
    gaussians, pictures = picked(power, kind="gaussians"), picked(power, kind="pictures")
    lines: list[Row] = []
    roc: dict[str, list[Row]] = {}
    for (scene, kind, amount), own in grouped([*gaussians, *pictures], "scene", "kind", "amount").items():
        z = [row["z"] for row in own]
        hits = round(share_claimed(z, CLAIM) * len(z))
        low, high = share_interval(hits, len(z))
        false = sum(row["wrong_hits"][LOG10_THRESHOLDS.index(-3.0)] for row in own if "wrong_hits" in row)
        lines.append(
            {
                "scene": scene,
                "evidence": kind,
                "how much": amount,
                "trials": len(z),
                "z": float(np.mean(z)),
                "z expected": float(np.mean([row["z_expected"] for row in own])),
                "claims at 1e-9 (95 %)": f"{100 * hits / len(z):.0f} % ({100 * low:.0f} to {100 * high:.0f})",
                "at 1e-3": f"{100 * share_claimed(z, -3.0):.0f} %",
                "wrong keys at 1e-3, measured": f"{false / max(sum(row.get('wrong', 0) for row in own), 1):.2g}",
            }
        )
        roc.setdefault(f"{amount:,} {kind if amount > 1 else kind[:-1]}", []).extend(own)
    text = (
        "Gaussians are those left after random pruning, unmoved. Trials of one number of pictures share pictures, so "
        "that their interval is a little too narrow. Pictures are of 128 pixels with noise of 0.2: one that a person "
        "would throw away."
    )
    title = f"A claim needs {_enough(gaussians, 'Gaussians')}, or {_enough(pictures, 'bad pictures')}"
    drawings = [
        Drawing(
            "power",
            partial(draw_power, gaussians, pictures, title),
            "Share of marked suspects claimed at 1e-9 against the amount of evidence.",
        ),
        Drawing(
            "roc",
            partial(draw_roc, _telling(roc), "ROC: right claims against the bound of a false one"),
            "ROC for evidence that is just enough and not enough.",
        ),
    ]
    return Section("Power", [text], [listed(lines)], drawings)


def _telling(roc: dict[str, list[Row]], most: int = 6) -> dict[str, list[Row]]:
    """The conditions nearest to the edge, where a ROC has something to show."""
    near = sorted(roc, key=lambda name: abs(float(np.mean([row["z"] for row in roc[name]])) - 6.0))
    return {name: roc[name] for name in roc if name in near[:most]}


def _enough(rows: Sequence[Row], what: str) -> str:
    """The least amount from which on at least 95 % claim."""
    amounts = sorted(distinct(rows, "amount"))
    short = [a for a in amounts if share_claimed([row["z"] for row in picked(rows, amount=a)], CLAIM) < 0.95]
    enough = amounts[amounts.index(short[-1]) + 1 :] if short else amounts
    if enough:
        return f"about {enough[0]:,} {what}"
    return f"more than {amounts[-1]:,} {what}" if amounts else f"no {what} measured"


STUDY = Study(
    "null",
    "Truth: measured false claims against the proven bound",
    "Does any unrelated key claim a suspect, and what does it take for the right key to do so?",
    cells,
    report,
)


LEAST_SHARE = 1e-8


def draw_false_claims(groups: Sequence[Rates], wrong: Rates, title: str) -> Figure:
    """Measured share of claims against the stated bound, log-log; the mistaken detector far above."""
    drawn, axes = figure(height=4.6)
    bounds = 10.0 ** np.array(LOG10_THRESHOLDS)
    tail = norm.sf([z_threshold(bound) for bound in bounds])
    axes.plot(bounds, bounds, color=INK, linewidth=1.2, label="the bound, exp(-z²/2)")
    axes.plot(bounds, tail, color=FAINT, linewidth=1.2, linestyle=(0, (1, 1)), label="normal tail")
    for style, rates in zip(styles(), groups, strict=False):
        seen = rates.shares > 0
        style |= {"linestyle": "none", "label": f"{rates.name}: {rates.keys:,} keys"}
        low, high = np.maximum(rates.intervals[seen], LEAST_SHARE).reshape(-1, 2).T
        spread_curve(axes, bounds[seen], rates.shares[seen], low, high, **style)
    if wrong.keys:
        label = f"a mistaken detector: {wrong.keys:,} keys"
        axes.plot(bounds, wrong.shares, color=INK, marker="x", linestyle="-.", linewidth=1.0, label=label)
    axes.set(xscale="log", yscale="log", xlim=(1.0, 1e-9), ylim=(LEAST_SHARE, 3.0), title=title)
    axes.set(xlabel="stated bound of a false claim", ylabel="measured share of wrong keys, 95 % intervals")
    axes.legend(loc="lower left", fontsize=7.0)
    return drawn


def draw_roc(groups: Mapping[str, Sequence[Row]], title: str) -> Figure:
    """Share of right claims against the stated bound of a false one, for thin and thinner evidence."""
    drawn, axes = figure(height=4.0)
    log10 = np.linspace(-12.0, -0.02, 200)
    for style, (name, rows) in zip(styles(), groups.items(), strict=False):
        shares = [share_claimed([row["z"] for row in rows], float(value)) for value in log10]
        axes.plot(10.0**log10, shares, label=name, markevery=20, **style)
    axes.plot(10.0**log10, 10.0**log10, color=FAINT, linewidth=1.0, linestyle=(0, (1, 1)), label="chance")
    axes.set(xscale="log", xlim=(1e-12, 1.0), title=title, ylabel="share of marked suspects claimed")
    axes.set(xlabel="bound of a false claim (proven; the measured rate lies below)")
    label_line(axes, 1e-9, "", along="y")
    axes.text(1.3e-9, 0.03, "a claim", fontsize=7.5, color="#6a6a6a")
    axes.legend(fontsize=7.0, loc="best")
    return drawn


def draw_power(gaussians: Sequence[Row], pictures: Sequence[Row], title: str) -> Figure:
    """Share of claims at 1e-9 against the amount of evidence."""
    drawn, axes = figure(1, 2, width=8.4, height=3.6, sharey=True, title=title)
    labels = ("Gaussians left of the model", "small noisy pictures together")
    for axis, rows, label in zip(axes, (gaussians, pictures), labels, strict=True):
        ticks: list[int] = []
        for style, (scene, own) in zip(styles(), grouped(rows, "scene").items(), strict=False):
            amounts = sorted(distinct(own, "amount"))
            z = [[row["z"] for row in picked(own, amount=amount)] for amount in amounts]
            shares = [share_claimed(values, CLAIM) for values in z]
            spread = [share_interval(round(s * len(v)), len(v)) for s, v in zip(shares, z, strict=True)]
            spread_curve(axis, amounts, shares, *np.array(spread).T, label=scene, **style)
            ticks = ticks or amounts
        axis.set(xscale="log", xlabel=label, ylim=(-0.03, 1.03))
        axis.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
        axis.minorticks_off()
    axes[0].set_ylabel("share claimed at 1e-9, 95 %")
    axes[0].legend(fontsize=7.0)
    return drawn
