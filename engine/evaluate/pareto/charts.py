"""Figures of speed against accuracy: ours beside what peers published, and what each knob of ours buys."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from engine.evaluate.drawing import INK, MARKERS, figure, label_line, styles
from engine.evaluate.pareto.summing import Result, pareto_front
from engine.evaluate.published import Published
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE, z_threshold

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Peer", "draw_foretold", "draw_main", "draw_rendering", "draw_time_and_fidelity", "peers"]

NAMED = ("fast", "balanced", "strong", "auto")
OTHERS = "#777777"
PICTURE_ATTACKS = ("JPEG 10", "JPEG 50", "noise 0.1", "crop 40 %")
"""Published under these words at 32 bits; a peer's point is the lowest of those it has."""

Peer = tuple[str, float, float, bool]
"""Name, seconds to embed, value, whether it reads without the original."""


def peers(published: Sequence[Published], what: str) -> list[Peer]:
    """Points of peers that published a time and `what`: "bits" (worst attacked picture, 32 bits) or "PSNR"."""
    found = []
    for method in dict.fromkeys(point.method for point in published):
        own = [point for point in published if point.method == method]
        times = [point.value for point in own if point.what == "embedding time"]
        values = [point.value for point in own if _counts(point, what)]
        if times and values:
            found.append((method, times[0], min(values), own[0].blind))
    return found


def _counts(point: Published, what: str) -> bool:
    if what == "PSNR":
        return point.what == "PSNR"
    return point.what == "bit accuracy" and point.conditions in {f"32 bits, {name}" for name in PICTURE_ATTACKS}


def draw_main(found: Sequence[Result], published: Sequence[Published], scene: str) -> Figure:
    """Time to embed against what is read: peers and ours; and ours alone, with its front."""
    drawn, (left, right) = figure(1, 2, width=10.4, height=4.4)
    ours = [result for result in found if result.point.bits == 32]
    others = peers(published, "bits")
    _peers_and_ours(left, others, [(r.point, r.embed_seconds, r.picture_bits) for r in ours])
    left.set_ylabel("bits right, worst attacked picture, %")
    left.set_title(_finding([r for r in ours if r.point.name in NAMED], others))
    left.set_ylim(min(83.0, *(r.picture_bits - 1.0 for r in ours)), 101.5)
    _evidence(right, found)
    right.set_title(f"Our settings, {scene}: what a second buys")
    return drawn


def _finding(named: Sequence[Result], others: Sequence[Peer]) -> str:
    seconds, bits = max(r.embed_seconds for r in named), min(r.picture_bits for r in named)
    values = [value for _, _, value, _ in others]
    return f"{bits:.3g} % of the bits in {_up(seconds)} s; peers {min(values):.0f} to {max(values):.0f} % in minutes"


def draw_time_and_fidelity(found: Sequence[Result], published: Sequence[Published]) -> Figure:
    """Time to embed against PSNR of the mark."""
    drawn, axes = figure(width=6.4, height=4.2)
    points = [(r.point, r.embed_seconds, float(r.row["psnr_worst_view"])) for r in found if r.point.bits == 32]
    _peers_and_ours(axes, peers(published, "PSNR"), points)
    axes.set_ylabel("PSNR of the mark, worst key view, dB")
    values = [value for _, _, value in points]
    axes.set_title(f"Marks of {min(values):.0f} to {max(values):.0f} dB beside published ones")
    return drawn


def _peers_and_ours(axes: Axes, others: Sequence[Peer], ours: Sequence[tuple[Any, float, float]]) -> None:
    axes.set_xscale("log")
    for _, seconds, value, blind in others:
        axes.plot(
            seconds,
            value,
            "o" if blind else "D",
            markerfacecolor="white",
            markeredgecolor=OTHERS,
            markersize=6,
            linestyle="none",
        )
    _name_points(axes, [(name, seconds, value) for name, seconds, value, _ in others])
    axes.plot(
        [],
        [],
        "o",
        markerfacecolor="white",
        markeredgecolor=OTHERS,
        linestyle="none",
        label="published, other hardware, blind",
    )
    if any(not blind for *_, blind in others):
        axes.plot(
            [],
            [],
            "D",
            markerfacecolor="white",
            markeredgecolor=OTHERS,
            linestyle="none",
            label="published, other hardware, informed",
        )
    axes.plot(
        [x for _, x, _ in ours],
        [y for _, _, y in ours],
        "s",
        color=next(styles())["color"],
        markersize=5,
        linestyle="none",
        label="ours, measured here, informed",
    )
    axes.set_xlabel("seconds to embed (log scale)")
    axes.set_xlim(min(x for _, x, _ in ours) / 2, 3e4)
    axes.legend(loc="lower left")


def _name_points(axes: Axes, points: Sequence[tuple[str, float, float]]) -> None:
    """Names beside points, on the side with more room: a point with a close neighbour above is named below it."""
    for name, x, y in points:
        close = [(a, b) for other, a, b in points if other != name and 0.4 < a / x < 2.6 and abs(b - y) < 1.0]
        below = any(b > y or (b == y and a > x) for a, b in close)
        left = x > 2000
        axes.annotate(
            name.replace(" (the paper)", ""),
            (x, y),
            xytext=(-6 if left else 6, -9 if below else 3),
            textcoords="offset points",
            ha="right" if left else "left",
            fontsize=7.5,
            color=INK,
        )


def _evidence(axes: Axes, found: Sequence[Result]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    kinds = dict.fromkeys(result.point.axis for result in found)
    for number, (kind, style) in enumerate(zip(kinds, styles(), strict=False)):
        own = [result for result in found if result.point.axis == kind]
        look = {"color": style["color"], "marker": style["marker"]}
        if number < len(MARKERS):
            look |= {"markeredgecolor": "white", "markeredgewidth": 0.5}
        else:  # colours and markers come round again: hollow this time
            look |= {"markerfacecolor": "none", "markeredgewidth": 1.2}
        axes.plot(
            [r.embed_seconds for r in own],
            [r.worst_z for r in own],
            linestyle="none",
            markersize=5.5,
            label=kind,
            **look,
        )
    points = [(result.embed_seconds, result.worst_z) for result in found]
    front = [points[index] for index in pareto_front(points)]
    axes.step([x for x, _ in front], [y for _, y in front], where="post", color=INK, linewidth=1.0, zorder=1)
    named = sorted((r for r in found if r.point.name in NAMED), key=lambda r: r.embed_seconds)
    for number, result in enumerate(named):  # in steps, so that near ones do not hide each other
        axes.annotate(
            result.point.name,
            (result.embed_seconds, result.worst_z),
            xytext=(0, 14 + 11 * (number % 3)),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            fontweight="bold",
            arrowprops={"arrowstyle": "-", "color": OTHERS, "linewidth": 0.7},
        )
    label_line(axes, z_threshold(CHANCE_RATE), "claim at 1e-9")
    label_line(axes, z_threshold(DISHONEST_CLAIMANT_RATE), "claim at 2^-128")
    top = max(y for _, y in points)
    axes.set_ylim(5.0, 1.5 * max(top, 16.0))
    _plain_ticks(axes, [5, 10, 20, 40, 80])
    axes.set_xlabel("seconds to embed (log scale)")
    axes.set_ylabel("z of the claim after the worst attack (log scale)")
    axes.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 0.16), fontsize=7)


def _plain_ticks(axes: Axes, values: Sequence[int]) -> None:
    low, high = axes.get_ylim()
    shown = [value for value in values if low <= value <= high]
    axes.set_yticks(shown, [str(value) for value in shown])
    axes.minorticks_off()
    low, high = axes.get_xlim()
    shown = [value for value in (1, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 200) if low <= value <= high]
    axes.set_xticks(shown, [str(value) for value in shown])


def draw_rendering(found: Sequence[Result]) -> Figure:
    """Rendering rate against fidelity to the owner's original."""
    drawn, axes = figure(width=6.4, height=4.0)
    kinds = [kind for kind in ("profile", "SH degree", "pruning", "corner") if _of(found, kind)]
    for kind, style in zip(kinds, styles(), strict=False):
        own = sorted(_of(found, kind), key=lambda r: r.frames_per_second)
        if kind == "corner":
            own = [result for result in own if result.point.name == "smallest"]
        axes.plot(
            [r.frames_per_second for r in own],
            [r.row["psnr_total_held_out"] for r in own],
            label={"corner": "pruned to 35 dB, compact"}.get(kind, kind),
            **(style if kind != "profile" else {**style, "linestyle": "none"}),
        )
        for result in own if kind in ("SH degree", "pruning") else []:
            name = result.point.name.replace("pruning-", "").replace(".0", " dB").replace("SH-", "degree ")
            axes.annotate(
                name,
                (result.frames_per_second, result.row["psnr_total_held_out"]),
                xytext=(5, 3),
                textcoords="offset points",
                fontsize=7.5,
            )
    width, height = found[0].row["frame_size"]
    axes.set_xlabel(f"pictures a second, {width}x{height}, this machine's CPU")
    axes.set_ylabel("PSNR against the original, worst unseen view, dB")
    base, fastest = found[0], max(found, key=lambda result: result.frames_per_second)
    axes.set_title(
        f"{base.frames_per_second:.0f} pictures a second as delivered by {base.point.name}, "
        f"{fastest.frames_per_second:.0f} by {fastest.point.name}"
    )
    axes.legend()
    return drawn


def _of(found: Sequence[Result], axis: str) -> list[Result]:
    return [result for result in found if result.point.axis == axis]


def draw_foretold(told: Sequence[Result]) -> Figure:
    """Predicted against measured z of the worst attacked picture."""
    drawn, axes = figure(width=4.8, height=4.2)
    scenes = dict.fromkeys(str(r.row["scene"]) for r in told)
    for scene, style in zip(scenes, styles(), strict=False):
        own = [r for r in told if r.row["scene"] == scene]
        axes.plot(
            [r.row["predicted_worst_z"] for r in own],
            [r.picture_z for r in own],
            linestyle="none",
            label=scene,
            **{name: value for name, value in style.items() if name != "linestyle"},
        )
    values = [r.row["predicted_worst_z"] for r in told] + [r.picture_z for r in told]
    ends = [0.9 * min(values), 1.1 * max(values)]
    axes.plot(ends, ends, color=INK, linewidth=0.8, zorder=1)
    axes.fill_between(ends, [0.8 * end for end in ends], [1.25 * end for end in ends], color="#eeeeee", zorder=0)
    axes.annotate("within 25 %", (ends[0], 1.25 * ends[0]), fontsize=7.5, color="#6a6a6a", va="bottom")
    axes.set_xlabel("z predicted by the rehearsal")
    axes.set_ylabel("z measured: worst of JPEG 10 and noise 0.1")
    off = max(abs(r.picture_z / r.row["predicted_worst_z"] - 1.0) for r in told)
    axes.set_title(f"Rehearsed before embedding: z within {100 * off:.0f} %")
    axes.legend()
    return drawn


def _up(seconds: float) -> str:
    """A bound that reads well: the next of 1, 2, 3, 5, 10, 15, 20, 30, ..."""
    steps = (1, 2, 3, 5, 10, 15, 20, 30, 45, 60, 90, 120, 180, 300, 600)
    return str(next((step for step in steps if seconds <= step), round(seconds)))
