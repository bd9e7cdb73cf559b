"""What all wrong keys, hostile suspects and thin evidence say together."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from engine.evaluate.intervals import share_interval
from engine.evaluate.null import figures
from engine.evaluate.null.counting import LOG10_THRESHOLDS
from engine.evaluate.null.rates import Rates, add_up, exceeding, share_claimed
from engine.evaluate.study import Bar, Drawing, Options, Report, Row, Section, Table

__all__ = ["report"]

WANTED_KEYS = 1_000_000
GROUPS = {
    "found": "suspects as found",
    "crafted": "suspects made to deceive",
    "copies": "other recipients, real keys",
    "other scene": "other scenes",
}


def report(rows: list[Row], options: Options) -> Report:
    """Bars on false claims first, then the counts, the counterexamples, the power, and the search for the mark."""
    tried = [row for row in rows if row["what"] == "null"]
    forged = [row for row in rows if row["what"] == "forged"]
    wrong = [row for row in rows if row["what"] == "wrong detector"]
    power = [row for row in rows if row["what"] == "power"]
    oracle = [row for row in rows if row["what"] == "oracle"]
    seen = [row for row in rows if row["what"] == "detectability"]
    rates = add_up(tried, "all")
    groups = [add_up([row for row in tried if row["group"] == group], name) for group, name in GROUPS.items()]
    bars = [*_null_bars(tried, forged, rates), *_counter_bars(wrong), *_detect_bars(seen)]
    claims = rates.hits[-1]
    answer = (
        f"{rates.keys:,} keys that had no part in the suspect they were tried on made {claims} claims at 1e-9; the "
        f"largest z was {max(row['z_largest'] for row in tried):.2f}, a claim needs 6.44."
    )
    return Report(
        bars,
        [
            _null_section(tried, [group for group in groups if group.keys], add_up(wrong, "wrong detector"), forged),
            _power_section(power),
            _oracle_section(oracle),
            _detect_section(seen),
        ],
        answer=[answer],
        summary={
            "wrong_keys": rates.keys,
            "claims": claims,
            "largest_z": max(row["z_largest"] for row in tried),
            "measured": {
                f"{10.0**log10:.3g}": float(share) for log10, share in zip(LOG10_THRESHOLDS, rates.shares, strict=True)
            },
        },
    )


def _null_bars(tried: Sequence[Row], forged: Sequence[Row], rates: Rates) -> list[Bar]:
    high = rates.intervals[-1, 1]
    above = [log10 for log10, share in zip(LOG10_THRESHOLDS, rates.shares, strict=True) if share > 10.0**log10]
    each = [f"{row['scene']}, {row['suspect']}, {row['route']}" for row in tried if exceeding(add_up([row], "one"))]
    clean = [row for row in tried if not row["carries"]] + [{**row, "suspect": "forged original"} for row in forged]
    claimed = [row["suspect"] for row in clean if row["verdict"] == "marked"]
    low_rate, high_rate = share_interval(len(claimed), len(clean))
    return [
        Bar(
            "claims at 1e-9 by wrong keys",
            "0",
            f"{rates.hits[-1]} of {rates.keys:,} (95 %: at most {high:.2g})",
            rates.hits[-1] == 0,
        ),
        Bar(
            "measured rate at or below the bound, all keys together",
            f"at all {len(LOG10_THRESHOLDS)} thresholds",
            f"{len(LOG10_THRESHOLDS) - len(above)} of {len(LOG10_THRESHOLDS)}"
            + "".join(f"; above at 1e{log10:g}" for log10 in above),
            not above,
        ),
        Bar(
            "measured rate of each suspect not above the bound beyond chance (exact, 95 %, thresholds counted)",
            "every suspect",
            f"{len(tried) - len(each)} of {len(tried)}" + "".join(f"; {name}" for name in each),
            not each,
        ),
        Bar(
            "records that claim an unmarked, foreign, crafted or forged suspect",
            "0",
            f"{len(claimed)} of {len(clean)} (95 %: {100 * low_rate:.1f} to {100 * high_rate:.1f} %)"
            + "".join(f"; {name}" for name in claimed),
            not claimed,
        ),
        Bar("wrong keys tried", f">= {WANTED_KEYS:,}", f"{rates.keys:,}", rates.keys >= WANTED_KEYS),
    ]


def _counter_bars(wrong: Sequence[Row]) -> list[Bar]:
    claims, keys = sum(row["claims"] for row in wrong), sum(row["keys"] for row in wrong)
    least = min((row["z_least"] for row in wrong), default=0.0)
    return [
        Bar(
            "a detector with the classic mistake is caught by this test",
            "claims by wrong keys",
            f"{claims} of {keys} wrong keys claim, least z {least:.0f}",
            claims > 0 if wrong else None,
        )
    ]


def _detect_bars(seen: Sequence[Row]) -> list[Bar]:
    marked = [row for row in seen if row["against"] == "marked"]
    blatant = [row for row in seen if row["against"].startswith("marked 20")]
    least = min((row["p"] for row in marked), default=1.0)
    level = 0.05 / max(len(marked), 1)
    strong = sum(row["p"] <= 0.05 for row in blatant)
    return [
        Bar(
            "distributions of a marked file's numbers: Sinkhorn divergence within chance",
            f"p > {level:.3g} (0.05 over {len(marked)} tests)",
            f"smallest p {least:.3g}; a mark 20 times as strong: p <= 0.05 in {strong} of {len(blatant)}",
            least > level if marked else None,
        )
    ]


def _null_section(tried: Sequence[Row], groups: Sequence[Rates], wrong: Rates, forged: Sequence[Row]) -> Section:
    lines = []
    for row in sorted(tried, key=lambda row: -row["z_largest"]):
        own = add_up([row], row["suspect"])
        at = {log10: own.shares[LOG10_THRESHOLDS.index(log10)] for log10 in (-1.0, -3.0, -5.0)}
        lines.append(
            [
                row["scene"],
                row["suspect"],
                row["route"],
                f"{row['keys']:,}",
                row["z_largest"],
                row["z_mean"],
                row["z_std"],
                *(f"{share:.2g}" for share in at.values()),
                own.hits[-1],
                f"{row['z_own']:.2f}: {row['verdict']}" + (" (carries it)" if row["carries"] else ""),
            ]
        )
    title = f"{sum(group.keys for group in groups):,} wrong keys: no claim, and always below the bound"
    if any(group.hits[-1] for group in groups):
        title = "Wrong keys claim: the bound is broken"
    elif any(exceeding(group) for group in groups):
        title = "Measured false claims lie above the bound"
    text = (
        "Each key draws chips of its own for the true reference and the very same evidence. For such keys the theorem "
        "allows at most exp(-z²/2), whatever the suspect is; real evidence of thousands of chips comes close to the "
        "normal tail below it. The mistaken detector rebuilds its reference as suspect minus own mark, and finds "
        "every key in everything. A forged original is somebody's marked model minus a mark of the thief's own, "
        f"registered by the right program: {len(forged)} tried, "
        f"largest z {max((row['z'] for row in forged), default=0.0):.2f}."
    )
    columns = [
        "scene",
        "suspect",
        "route",
        "keys",
        "largest z",
        "mean",
        "std",
        "at 0.1",
        "at 1e-3",
        "at 1e-5",
        "claims",
        "this record's own z and answer",
    ]
    drawing = Drawing(
        "false-claims",
        partial(figures.draw_false_claims, groups, wrong if wrong.keys else None, title),
        "Share of wrong keys that reach each stated bound. Where nothing is drawn no key came so far.",
    )
    return Section("False claims", [text], [Table(columns, lines, "Largest z first")], [drawing])


def _power_section(power: Sequence[Row]) -> Section:
    gaussians = [row for row in power if row["kind"] == "gaussians"]
    pictures = [row for row in power if row["kind"] == "pictures"]
    lines = []
    roc: dict[str, list[Row]] = {}
    for kind, rows in (("gaussians", gaussians), ("pictures", pictures)):
        for key in dict.fromkeys((row["scene"], row["amount"]) for row in rows):
            own = [row for row in rows if (row["scene"], row["amount"]) == key]
            z = [row["z"] for row in own]
            hits = round(share_claimed(z, -9.0) * len(z))
            low, high = share_interval(hits, len(z))
            wrong = sum(row.get("wrong", 0) for row in own)
            false = sum(row["wrong_hits"][LOG10_THRESHOLDS.index(-3.0)] for row in own if "wrong_hits" in row)
            lines.append(
                [
                    key[0],
                    kind,
                    key[1],
                    len(z),
                    float(np.mean(z)),
                    float(np.mean([row["z_expected"] for row in own])),
                    f"{100 * hits / len(z):.0f} % ({100 * low:.0f} to {100 * high:.0f})",
                    f"{100 * share_claimed(z, -3.0):.0f} %",
                    f"{false / max(wrong, 1):.2g}",
                ]
            )
            roc.setdefault(f"{key[1]:,} {kind if key[1] > 1 else kind[:-1]}", []).extend(own)
    shown = _telling(roc)
    columns = [
        "scene",
        "evidence",
        "how much",
        "trials",
        "z",
        "z expected",
        "claims at 1e-9 (95 %)",
        "at 1e-3",
        "wrong keys at 1e-3, measured",
    ]
    text = (
        "Gaussians are those left after random pruning, unmoved. Trials of one number of pictures share pictures, so "
        "that their interval is a little too narrow. Pictures are of 128 pixels with noise of 0.2: one that a person "
        "would throw away."
    )
    title = f"A claim needs {_enough(gaussians, 'Gaussians')}, or {_enough(pictures, 'bad pictures')}"
    return Section(
        "Power",
        [text],
        [Table(columns, lines)],
        [
            Drawing(
                "power",
                partial(figures.draw_power, gaussians, pictures, title),
                "Share of marked suspects claimed at 1e-9 against the amount of evidence.",
            ),
            Drawing(
                "roc",
                partial(figures.draw_roc, shown, "ROC: right claims against the bound of a false one"),
                "ROC for evidence that is just enough and not enough.",
            ),
        ],
    )


def _telling(roc: dict[str, list[Row]], most: int = 6) -> dict[str, list[Row]]:
    """The conditions nearest to the edge, where a ROC has something to show."""
    near = sorted(roc, key=lambda name: abs(float(np.mean([row["z"] for row in roc[name]])) - 6.0))
    return {name: roc[name] for name in roc if name in near[:most]}


def _enough(rows: Sequence[Row], what: str) -> str:
    amounts = sorted({row["amount"] for row in rows})
    for amount in amounts:
        if all(share_claimed([r["z"] for r in rows if r["amount"] == a], -9.0) >= 0.95 for a in amounts if a >= amount):
            return f"about {amount:,} {what}"
    return f"more than {amounts[-1]:,} {what}" if amounts else f"no {what} measured"


def _oracle_section(oracle: Sequence[Row]) -> Section:
    told = [row["queries"] for row in oracle if row["z_told_z"] >= row["z_threshold"]]
    verdicts = max((row["z_told_verdict"] for row in oracle), default=0.0)
    after = f"after {min(told)} questions" if told else "after no number of questions tried"
    text = (
        "The bound speaks of keys that had no part in the suspect. A detector that answers strangers takes part: told "
        f"z, a stranger who is even given the code vectors frames the owner {after}. Told the verdict alone he learns "
        f"nothing this way (largest z {verdicts:.1f}); one who holds a marked copy could still walk along the edge of "
        "the verdict, which was not tried. This is why z belongs to the owner, and why the service answers others "
        "coarsely and counts their questions."
    )
    title = f"An oracle that tells z is enough to frame its owner {after}"
    drawing = Drawing("oracle", partial(figures.draw_oracle, oracle, title), "z of the sum of liked patterns.")
    return Section("What the owner's own answers give away", [text], [], [drawing])


def _detect_section(seen: Sequence[Row]) -> Section:
    lines = [
        [
            row["scene"],
            row["key"],
            row["features"],
            row["against"],
            row["distance"],
            row["null_median"],
            row["null_highest"],
            row["p"],
        ]
        for row in seen
    ]
    text = (
        "Two disjoint random samples of one scene's Gaussians, compared by Sinkhorn divergence (entropy a "
        "tenth of the median cost, attributes in standard deviations); p is the share of random divisions of the joint "
        "sample at least as far apart. Samples of a few hundred see what stands out, not what millions of values "
        "together might; the learned detector of the study steganalysis looks further."
    )
    least = min((row["p"] for row in seen if row["against"] == "marked"), default=1.0)
    columns = [
        "scene",
        "key",
        "attributes",
        "unmarked sample against",
        "divergence",
        "median of chance",
        "largest of chance",
        "p",
    ]
    title = f"In the numbers of the file the mark is within chance (smallest p {least:.2f})"
    if least <= 0.05 / max(sum(row["against"] == "marked" for row in seen), 1):
        title = f"The numbers of the file betray the mark (p {least:.3f})"
    drawing = Drawing(
        "detectability", partial(figures.draw_detectability, seen, title), "Each point is one key and scene."
    )
    return Section("Can the mark be seen in the file's numbers?", [text], [Table(columns, lines)], [drawing])
