"""Suite 4: calibration. Does the measured rate of false claims keep below the stated bound, whatever is tried?

Full: about 20 suspects with a million wrong keys each, 10,000 other recipients, power from thinned models and from
bad pictures, a detector that must fail, and forged originals: about 10 minutes a scene of 100k Gaussians on 2
cores. Quick: the same with 100,000 keys, few trials, small views.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.null import null_cells
from engine.lab.evaluate.null.null_rates import CLAIM, LOG10_THRESHOLDS, Rates, add_up, exceeding, share_claimed
from engine.lab.evaluate.study import Bar, Cell, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import distinct, grouped, listed, picked, table

__all__ = ["STUDY"]

SHARES = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0005, 0.00025)
PICTURES = (1, 2, 4, 8, 16)
WANTED_KEYS = 1_000_000


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
        [_null_section(tried, forged), _power_section(power)],
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


def _null_section(tried: Sequence[Row], forged: Sequence[Row]) -> Section:
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
    return Section("False claims", [text], [shown])


def _power_section(power: Sequence[Row]) -> Section:
    gaussians, pictures = picked(power, kind="gaussians"), picked(power, kind="pictures")
    lines: list[Row] = []
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
    text = (
        f"A claim needs {_enough(gaussians, 'Gaussians')}, or {_enough(pictures, 'bad pictures')}. "
        "Gaussians are those left after random pruning, unmoved. Trials of one number of pictures share pictures, so "
        "that their interval is a little too narrow. Pictures are of 128 pixels with noise of 0.2: one that a person "
        "would throw away."
    )
    return Section("Power", [text], [listed(lines)])


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
