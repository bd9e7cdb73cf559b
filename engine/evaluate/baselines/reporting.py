"""What the baselines study says: methods side by side at one fidelity, and what peers published."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from engine.evaluate.baselines.figures import draw_matrix
from engine.evaluate.baselines.measuring import BITS, LEAST_MATCHES
from engine.evaluate.baselines.methods import METHODS
from engine.evaluate.intervals import share_interval
from engine.evaluate.published import read_published
from engine.evaluate.study import Bar, Drawing, Options, Report, Row, Section, Table
from engine.watermark.statistics import log10_binomial_tail

__all__ = ["report"]

TABLE_2 = (
    "none",
    "rotation 30 deg",
    "scale 0.75",
    "crop 40 % of the area",
    "JPEG 10",
    "noise std 0.1",
    "clone 50 %",
    "prune random 20 %",
)
LEAST = 99.9
"""Per cent of bits: the bar of DESIGN 12 on Table 2."""
NAMES = {"ours": "ours", **{short: method.name for short, method in METHODS.items()}}


def report(rows: list[Row], options: Options) -> Report:
    """Bits of every method under every attack; false claims; published numbers apart."""
    attacks = [row for row in rows if row["what"] == "attack"]
    skipped = [row for row in rows if row["what"] == "skipped"]
    methods = [name for name in NAMES if any(row["method"] == name for row in attacks)]
    missing = [f"{NAMES[n]} was not run: {r}" for n, r in {row["method"]: row["reason"] for row in skipped}.items()]
    shares = _shares(attacks)
    lines = list(dict.fromkeys((row["on"], row["attack"]) for row in attacks))
    labels = {(on, attack): f"{attack} ({on})" for on, attack in lines}
    matrix = {(labels[on, attack], NAMES[name]): value for (on, attack, name), value in shares.items()}
    lost = {name: sum(value < LEAST for (_, _, whose), value in shares.items() if whose == name) for name in methods}
    readable = {name: sum(whose == name for _, _, whose in shares) for name in methods}
    title = "Attacks that cost bits: " + ", ".join(
        f"{_short(name)} {lost[name]} of {readable[name]}" for name in methods
    )
    drawing = Drawing(
        "matrix",
        partial(draw_matrix, list(labels.values()), [NAMES[n] for n in methods], matrix, title),
        "Bits read right, mean over scenes, keys and pictures, at one PSNR; chance is 50 %. A dash: the method reads "
        "no pictures.",
    )
    return Report(
        _bars(attacks, skipped),
        [
            Section(
                "Attacks",
                [
                    "Every method marks the same scenes with 32 bits at one PSNR in the worst of views drawn alike. "
                    "Ours and the spread spectrum are informed: they compare with the original. The others are blind, "
                    "a harder problem. Fitted methods are read at the owner's training views, their best case.",
                    *missing,
                ],
                [_attack_table(attacks, methods)],
                [drawing],
            ),
            Section(
                "False claims",
                [
                    f"Other owners' keys and messages on the marked model. The field accepts a mark from "
                    f"{LEAST_MATCHES} of {BITS} bits on, which fair bits reach with probability "
                    f"{10 ** log10_binomial_tail(LEAST_MATCHES, BITS):.1g}. Ours claims by a proven bound of 1e-9, "
                    "whatever bits are read."
                ],
                [_false_table(rows)],
            ),
            Section("Fidelity and time", [], [_embedding_table(rows)]),
            Section(
                "What these methods stand for", [f"{METHODS[n].name}: {METHODS[n].stands_for}." for n in methods[1:]]
            ),
            _published_section(),
        ],
        answer=[title + ".", *missing],
        summary={"lost": lost, "read": readable},
    )


def _short(name: str) -> str:
    return {"qim": "QIM", "spread": "spread spectrum", "dct": "fitted DCT", "rivagan": "fitted RivaGAN"}.get(name, name)


def _shares(attacks: Sequence[Row]) -> dict[tuple[str, str, str], float]:
    """Per cent of bits read right by (on, attack, method)."""
    groups: dict[tuple[str, str, str], list[int]] = {}
    for row in attacks:
        if row["right"] is not None:
            groups.setdefault((row["on"], row["attack"], row["method"]), []).append(row["right"])
    return {place: 100.0 * float(np.mean(right)) / BITS for place, right in groups.items()}


def _bars(attacks: Sequence[Row], skipped: Sequence[Row]) -> list[Bar]:
    bars = []
    for attack in TABLE_2:
        own = [row for row in attacks if row["method"] == "ours" and row["attack"] == attack]
        if not own:
            continue
        right, total = sum(row["right"] for row in own), BITS * len(own)
        low, high = share_interval(right, total)
        others = {
            row["method"]: _rate([r for r in attacks if r["method"] == row["method"] and r["attack"] == attack])
            for row in attacks
            if row["method"] != "ours" and row["attack"] == attack and row["right"] is not None
        }
        beside = ", ".join(f"{_short(name)} {value:.1f}" for name, value in others.items())
        bars.append(
            Bar(
                f"32 bits after: {attack}",
                f">= {LEAST} %",
                f"{100 * right / total:.2f} % (95 % {100 * low:.1f} to {100 * high:.1f}, n = {len(own)}); {beside}",
                100 * right / total >= LEAST,
            )
        )
    reasons = {row["method"]: row["reason"] for row in skipped}
    bars += [Bar(f"{NAMES[name]} beside ours", "run", reason, None) for name, reason in reasons.items()]
    return bars


def _rate(rows: Sequence[Row]) -> float:
    return 100.0 * float(np.mean([row["right"] for row in rows if row["right"] is not None])) / BITS


def _attack_table(attacks: Sequence[Row], methods: Sequence[str]) -> Table:
    lines = []
    for on, attack in dict.fromkeys((row["on"], row["attack"]) for row in attacks):
        line = [attack, on]
        for name in methods:
            right = [
                row["right"]
                for row in attacks
                if (row["on"], row["attack"], row["method"]) == (on, attack, name) and row["right"] is not None
            ]
            if not right:
                line.append("cannot read it")
                continue
            low, high = share_interval(sum(right), BITS * len(right))
            line.append(f"{100 * np.mean(right) / BITS:.1f} ({100 * low:.1f} to {100 * high:.1f})")
        lines.append(line)
    columns = ["attack", "on", *(NAMES[name] for name in methods)]
    return Table(columns, lines, "Bits read right, % (95 % interval, bits taken as independent)")


def _false_table(rows: Sequence[Row]) -> Table:
    lines = []
    for name in NAMES:
        own = [row for row in rows if row["what"] == "wrong keys" and row["method"] == name]
        if not own:
            continue
        keys, accepted = sum(row["keys"] for row in own), sum(row["accepted"] for row in own)
        low, high = share_interval(accepted, keys)
        most = max((row["most_matches"] for row in own if "most_matches" in row), default=None)
        unmarked = [row["unmarked_matches"] for row in own if "unmarked_matches" in row]
        lines.append(
            [
                NAMES[name],
                keys,
                accepted,
                f"{low:.1g} to {high:.1g}",
                "by z" if most is None else f"{most} of {BITS}",
                "" if not unmarked else f"{np.mean(unmarked):.1f} of {BITS}, at most {max(unmarked)}",
            ]
        )
    columns = [
        "method",
        "wrong keys",
        "accepted",
        "95 % of the rate",
        "most bits matched",
        "bits matched by the right key on the unmarked model",
    ]
    return Table(columns, lines)


def _embedding_table(rows: Sequence[Row]) -> Table:
    lines = []
    for name in NAMES:
        own = [row for row in rows if row["what"] == "embedding" and row["method"] == name]
        if own:
            lines.append(
                [
                    NAMES[name],
                    f"{np.mean([row['psnr'] for row in own]):.2f}",
                    f"{min(row['psnr'] for row in own):.2f}",
                    f"{np.mean([row['ssim'] for row in own]):.5f}",
                    f"{np.median([row['seconds'] for row in own]):.1f}",
                ]
            )
    return Table(["method", "PSNR of the worst view, mean", "least", "its SSIM, mean", "seconds to embed"], lines)


def _published_section() -> Section:
    lines = [
        [
            p.method,
            f"{p.venue} {p.year}",
            p.what,
            p.conditions,
            p.value,
            p.unit,
            "blind" if p.blind else "informed",
            p.hardware,
            p.source,
        ]
        for p in read_published()
    ]
    columns = ["method", "where", "what", "conditions", "value", "unit", "reading", "hardware", "source"]
    text = "Published, other hardware, other scenes; blind or informed as it says. Not measured here."
    return Section("Published numbers", [text], [Table(columns, lines)])
