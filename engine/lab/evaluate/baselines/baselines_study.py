"""Suite 6: other methods on the same scenes, at the same fidelity, under the same attacks.

Full: 3 keys of ours and of each method, 16 attacks on the model and 9 on each of 3 pictures, 100 wrong keys; on 2 cores
and a scene of 100k Gaussians about 20 minutes, 35 where RivaGAN is installed. Quick: one key, few attacks, small views.
"""

import textwrap
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from engine.lab.evaluate.baselines.baselines_cells import BITS, LEAST_MATCHES, attack_baseline, attack_ours
from engine.lab.evaluate.baselines.methods import METHODS
from engine.lab.evaluate.figures import SEQUENTIAL, Figure, figure
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.published import read_published
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Report, Row, Section, Study, Table
from engine.lab.evaluate.summary import distinct, grouped, listed, picked, table
from engine.watermark.statistics import log10_binomial_tail

__all__ = ["STUDY"]

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
SHORT = {"ours": "ours", "qim": "QIM", "spread": "spread spectrum", "dct": "fitted DCT", "rivagan": "fitted RivaGAN"}
COLUMN_LETTERS = 14
"""What fits above a column of the figure."""


def cells(options: Options) -> list[Cell]:
    """One cell for each scene, method and key."""
    keys, pictures, wrong_keys = (1, 1, 5) if options.quick else (3, 3, 100)
    made = []
    for number, path in enumerate(options.scenes):
        for seed in range(options.seed, options.seed + keys):
            shared = {"path": path, "seed": seed, "pictures": pictures, "quick": options.quick}
            made.append(Cell.of(f"{number}-ours-{seed}", attack_ours, **shared))
            for method in METHODS:
                name = f"{number}-{method}-{seed}"
                made.append(Cell.of(name, attack_baseline, **shared, method=method, wrong_keys=wrong_keys))
    return made


def report(rows: list[Row], options: Options) -> Report:
    """Bits of every method under every attack; false claims; published numbers apart."""
    attacks, skipped = picked(rows, what="attack"), picked(rows, what="skipped")
    methods = [name for name in NAMES if picked(attacks, method=name)]
    reasons = {row["method"]: row["reason"] for row in skipped}
    missing = [f"{NAMES[name]} was not run: {reason}" for name, reason in reasons.items()]
    shares = {place: _share(own) for place, own in grouped(_readable(attacks), "on", "attack", "method").items()}
    lost = {name: sum(value < LEAST for (_, _, whose), value in shares.items() if whose == name) for name in methods}
    readable = {name: sum(whose == name for _, _, whose in shares) for name in methods}
    title = "Attacks that cost bits: " + ", ".join(
        f"{SHORT[name]} {lost[name]} of {readable[name]}" for name in methods
    )
    drawing = Drawing(
        "matrix",
        partial(draw_matrix, distinct(attacks, "on", "attack"), methods, shares, title),
        "Bits read right, mean over scenes, keys and pictures, at one PSNR; chance is 50 %. A dash: the method reads "
        "no pictures.",
    )
    not_run = [Bar(f"{NAMES[name]}, for comparison", "run", reason, None) for name, reason in reasons.items()]
    return Report(
        [*_bars(attacks), *not_run],
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


def _readable(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["right"] is not None]


def _share(rows: Sequence[Row]) -> float:
    """Per cent of bits read right."""
    return 100.0 * float(np.mean([row["right"] for row in rows])) / BITS


def _interval(rows: Sequence[Row]) -> tuple[float, float]:
    """Its 95 % interval, bits taken as independent."""
    low, high = share_interval(sum(row["right"] for row in rows), BITS * len(rows))
    return 100 * low, 100 * high


def _bars(attacks: Sequence[Row]) -> list[Bar]:
    bars = []
    for attack in TABLE_2:
        methods = grouped(_readable(picked(attacks, attack=attack)), "method")
        if own := methods.pop("ours", None):
            low, high = _interval(own)
            others = ", ".join(f"{SHORT[name]} {_share(rows):.1f}" for name, rows in methods.items())
            measured = f"{_share(own):.2f} % (95 % {low:.1f} to {high:.1f}, n = {len(own)}); {others}"
            bars.append(Bar(f"32 bits after: {attack}", f">= {LEAST} %", measured, _share(own) >= LEAST))
    return bars


def _attack_table(attacks: Sequence[Row], methods: Sequence[str]) -> Table:
    def entry(rows: Sequence[Row]) -> str:
        if not rows:
            return "cannot read it"
        low, high = _interval(rows)
        return f"{_share(rows):.1f} ({low:.1f} to {high:.1f})"

    lines = [
        {"attack": attack, "on": on} | {NAMES[name]: entry(_readable(picked(own, method=name))) for name in methods}
        for (on, attack), own in grouped(attacks, "on", "attack").items()
    ]
    return listed(lines, "Bits read right, % (95 % interval, bits taken as independent)")


def _by_method(rows: Sequence[Row], what: str) -> dict[str, list[Row]]:
    """Rows of each method, in the order of the names."""
    groups = grouped(picked(rows, what=what), "method")
    return {name: groups[name] for name in NAMES if name in groups}


def _false_table(rows: Sequence[Row]) -> Table:
    lines = []
    for name, own in _by_method(rows, "wrong keys").items():
        keys, accepted = sum(row["keys"] for row in own), sum(row["accepted"] for row in own)
        low, high = share_interval(accepted, keys)
        most = max((row["most_matches"] for row in own if "most_matches" in row), default=None)
        unmarked = [row["unmarked_matches"] for row in own if "unmarked_matches" in row]
        right = f"{np.mean(unmarked):.1f} of {BITS}, at most {max(unmarked)}" if unmarked else ""
        lines.append(
            {
                "method": NAMES[name],
                "wrong keys": keys,
                "accepted": accepted,
                "95 % of the rate": f"{low:.1g} to {high:.1g}",
                "most bits matched": "by z" if most is None else f"{most} of {BITS}",
                "bits matched by the right key on the unmarked model": right,
            }
        )
    return listed(lines)


def _embedding_table(rows: Sequence[Row]) -> Table:
    return listed(
        [
            {
                "method": NAMES[name],
                "PSNR of the worst view, mean": f"{np.mean([row['psnr'] for row in own]):.2f}",
                "least": f"{min(row['psnr'] for row in own):.2f}",
                "its SSIM, mean": f"{np.mean([row['ssim'] for row in own]):.5f}",
                "seconds to embed": f"{np.median([row['seconds'] for row in own]):.1f}",
            }
            for name, own in _by_method(rows, "embedding").items()
        ]
    )


def _published_section() -> Section:
    columns = (
        "method",
        ("where", "{venue} {year}"),
        "what",
        "conditions",
        "value",
        "unit",
        "reading",
        "hardware",
        "source",
    )
    points = [{**vars(point), "reading": "blind" if point.blind else "informed"} for point in read_published()]
    text = "Published, other hardware, other scenes; blind or informed as it says. Not measured here."
    return Section("Published numbers", [text], [table(points, "method", ("where", "{venue} {year}"), *columns)])


def draw_matrix(
    attacks: Sequence[tuple[str, str]], methods: Sequence[str], shares: Mapping[tuple[str, str, str], float], title: str
) -> Figure:
    """Bit accuracy, per cent, as colours and numbers; empty where a method cannot read such a thing."""
    values = np.array([[shares.get((*attack, method), np.nan) for method in methods] for attack in attacks])
    drawn, axes = figure(width=3.4 + 1.4 * len(methods), height=1.3 + 0.26 * len(attacks), title=title)
    image = axes.imshow(values, cmap=SEQUENTIAL, vmin=50, vmax=100, aspect="auto")
    axes.set_xticks(range(len(methods)), [textwrap.fill(NAMES[method], COLUMN_LETTERS) for method in methods])
    axes.set_yticks(range(len(attacks)), [f"{attack} ({on})" for on, attack in attacks])
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.grid(visible=False)
    for (row, column), value in np.ndenumerate(values):
        text, color = ("-" if np.isnan(value) else f"{value:.1f}"), ("white" if value < 78 else "black")
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color=color)
    drawn.colorbar(image, ax=axes, shrink=0.6).set_label("bits right, %")
    return drawn


STUDY = Study(
    "baselines", "Other methods, here", "What do other ways of marking keep, where ours is measured?", cells, report
)
