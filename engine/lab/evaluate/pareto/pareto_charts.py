"""Figures of speed against accuracy: ours next to published ones, and what each knob of ours buys."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from engine.lab.evaluate.figures import INK, MARKERS, Axes, Figure, figure, label_line, styles
from engine.lab.evaluate.machine import machine_info
from engine.lab.evaluate.pareto.pareto_sums import Result, pareto_front
from engine.lab.evaluate.published import Published
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE, z_threshold

NAMED = ("fast", "balanced", "strong", "auto")
OTHERS = "#777777"
PICTURE_ATTACKS = ("JPEG 10", "JPEG 50", "noise 0.1", "crop 40 %")
"""Published under these words at 32 bits; a peer's point is the lowest of those it has."""
TICKS = (1, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 200)
BOUNDS = (1, 2, 3, 5, 10, 15, 20, 30, 45, 60, 90, 120, 180, 300, 600)
"""Numbers of seconds that read well, on an axis and in a sentence."""

Peer = tuple[str, float, float, bool]
"""Name and hardware, seconds to embed, value, whether it reads without the original."""


def peers(published: Sequence[Published], what: str) -> list[Peer]:
    """Points of peers that published a time and `what`: "bits" (worst attacked picture, 32 bits) or "PSNR"."""
    conditions = {f"32 bits, {name}" for name in PICTURE_ATTACKS}
    found = []
    for method in dict.fromkeys(point.method for point in published):
        own = [point for point in published if point.method == method]
        times = [(point.value, point.hardware) for point in own if point.what == "embedding time"]
        if what == "PSNR":
            values = [point.value for point in own if point.what == "PSNR"]
        else:
            values = [point.value for point in own if point.what == "bit accuracy" and point.conditions in conditions]
        if times and values:
            seconds, hardware = times[0]
            found.append((f"{method}, {hardware}", seconds, min(values), own[0].blind))
    return found


def draw_main(found: Sequence[Result], published: Sequence[Published], scene: str) -> Figure:
    """Time to embed against what is read: peers and ours; and ours alone, with its front."""
    drawn, (left, right) = figure(1, 2, width=10.4, height=4.4)
    ours = [result for result in found if result.point.bits == 32]
    others = peers(published, "bits")
    _peers_and_ours(left, others, [(r.embed_seconds, r.picture_bits) for r in ours])
    named = [result for result in ours if result.point.name in NAMED]
    seconds, bits = max(r.embed_seconds for r in named), min(r.picture_bits for r in named)
    theirs = [value for _, _, value, _ in others]
    bound = next((step for step in BOUNDS if seconds <= step), round(seconds))
    left.set(
        ylabel="bits right, worst attacked picture, %",
        ylim=(min(83.0, *(r.picture_bits - 1.0 for r in ours)), 101.5),
        title=f"{bits:.3g} % of the bits in {bound} s; peers {min(theirs):.0f} to {max(theirs):.0f} % in minutes",
    )
    _evidence(right, found)
    right.set_title(f"Our settings, {scene}: what a second buys")
    return drawn


def draw_time_and_fidelity(found: Sequence[Result], published: Sequence[Published]) -> Figure:
    """Time to embed against PSNR of the mark."""
    drawn, axes = figure(width=6.4, height=4.2)
    points = [(r.embed_seconds, float(r.row["psnr_worst_view"])) for r in found if r.point.bits == 32]
    _peers_and_ours(axes, peers(published, "PSNR"), points)
    values = [value for _, value in points]
    title = f"Marks of {min(values):.0f} to {max(values):.0f} dB and published ones"
    axes.set(ylabel="PSNR of the mark, worst key view, dB", title=title)
    return drawn


def _peers_and_ours(axes: Axes, others: Sequence[Peer], ours: Sequence[tuple[float, float]]) -> None:
    axes.set_xscale("log")
    hollow = partial(axes.plot, markersize=6, markerfacecolor="white", markeredgecolor=OTHERS, linestyle="none")
    for mark, blind in (("o", True), ("D", False)):
        points = [(seconds, value) for _, seconds, value, reads_blind in others if reads_blind is blind]
        if points or blind:
            label = f"published, hardware as named, {'blind' if blind else 'informed'}"
            hollow([x for x, _ in points], [y for _, y in points], mark, label=label)
    _name_points(axes, [(name, seconds, value) for name, seconds, value, _ in others])
    seconds = [x for x, _ in ours]
    look = {"color": next(styles())["color"], "markersize": 5, "linestyle": "none"}
    axes.plot(seconds, [y for _, y in ours], "s", label=f"ours, measured here ({_here()}), informed", **look)
    axes.set(xlabel="seconds to embed (log scale)", xlim=(min(seconds) / 2, 3e4))
    axes.legend(loc="lower left")


def _here() -> str:
    machine = machine_info()
    return f"{machine['cores_usable']} cores of {machine['cpu']}"


def _name_points(axes: Axes, points: Sequence[tuple[str, float, float]]) -> None:
    """Names next to points, on the side with more room: a point with a close neighbour above is named below it."""
    for name, x, y in points:
        close = [(a, b) for other, a, b in points if other != name and 0.4 < a / x < 2.6 and abs(b - y) < 1.0]
        height = -9 if any(b > y or (b == y and a > x) for a, b in close) else 3
        offset, side = ((-6, height), "right") if x > 2000 else ((6, height), "left")
        _annotate(axes, name.replace(" (the paper)", ""), (x, y), offset, ha=side)


def _annotate(axes: Axes, text: str, at: tuple[float, float], offset: tuple[float, float], **look: Any) -> None:
    axes.annotate(text, at, xytext=offset, textcoords="offset points", **{"fontsize": 7.5, "color": INK, **look})


def _evidence(axes: Axes, found: Sequence[Result]) -> None:
    kinds = dict.fromkeys(result.point.axis for result in found)
    for number, (kind, style) in enumerate(zip(kinds, styles(), strict=False)):
        own = _of(found, kind)
        look = {"color": style["color"], "marker": style["marker"], "linestyle": "none", "markersize": 5.5}
        if number < len(MARKERS):
            look |= {"markeredgecolor": "white", "markeredgewidth": 0.5}
        else:  # colours and markers come round again: hollow this time
            look |= {"markerfacecolor": "none", "markeredgewidth": 1.2}
        axes.plot([r.embed_seconds for r in own], [r.worst_z for r in own], label=kind, **look)
    points = [(result.embed_seconds, result.worst_z) for result in found]
    front = [points[index] for index in pareto_front(points)]
    axes.step([x for x, _ in front], [y for _, y in front], where="post", color=INK, linewidth=1.0, zorder=1)
    named = sorted((r for r in found if r.point.name in NAMED), key=lambda r: r.embed_seconds)
    for number, result in enumerate(named):  # in steps, so that near ones do not hide each other
        line = {"arrowstyle": "-", "color": OTHERS, "linewidth": 0.7}
        at, offset = (result.embed_seconds, result.worst_z), (0, 14 + 11 * (number % 3))
        _annotate(axes, result.point.name, at, offset, ha="center", fontsize=8, fontweight="bold", arrowprops=line)
    label_line(axes, z_threshold(CHANCE_RATE), "claim at 1e-9")
    label_line(axes, z_threshold(DISHONEST_CLAIMANT_RATE), "claim at 2^-128")
    top = max(y for _, y in points)
    axes.set(
        xscale="log",
        yscale="log",
        ylim=(5.0, 1.5 * max(top, 16.0)),
        xlabel="seconds to embed (log scale)",
        ylabel="z of the claim after the worst attack (log scale)",
    )
    low, high = axes.get_ylim()
    axes.set_yticks(shown := [value for value in (5, 10, 20, 40, 80) if low <= value <= high], list(map(str, shown)))
    low, high = axes.get_xlim()
    axes.set_xticks(shown := [value for value in TICKS if low <= value <= high], list(map(str, shown)))
    axes.minorticks_off()
    axes.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 0.16), fontsize=7)


def draw_rendering(found: Sequence[Result]) -> Figure:
    """Rendering rate against fidelity to the owner's original."""
    drawn, axes = figure(width=6.4, height=4.0)
    kinds = [kind for kind in ("profile", "SH degree", "pruning", "corner") if _of(found, kind)]
    for kind, style in zip(kinds, styles(), strict=False):
        own = sorted(_of(found, kind), key=lambda r: r.frames_per_second)
        if kind == "corner":
            own = [result for result in own if result.point.name == "smallest"]
        points = [(r.frames_per_second, float(r.row["psnr_total_held_out"])) for r in own]
        look = style if kind != "profile" else {**style, "linestyle": "none"}
        label = {"corner": "pruned to 35 dB, compact"}.get(kind, kind)
        axes.plot([x for x, _ in points], [y for _, y in points], label=label, **look)
        for result, at in zip(own, points, strict=True) if kind in ("SH degree", "pruning") else []:
            name = result.point.name.replace("pruning-", "").replace(".0", " dB").replace("SH-", "degree ")
            _annotate(axes, name, at, (5, 3))
    width, height = found[0].row["frame_size"]
    base, fastest = found[0], max(found, key=lambda result: result.frames_per_second)
    axes.set(
        xlabel=f"pictures a second, {width}x{height}, this machine's CPU",
        ylabel="PSNR against the original, worst unseen view, dB",
        title=f"{base.frames_per_second:.0f} pictures a second as delivered by {base.point.name}, "
        f"{fastest.frames_per_second:.0f} by {fastest.point.name}",
    )
    axes.legend()
    return drawn


SPENDING = {
    "profile": "profiles",
    "auto": "auto",
    "SH degree": "fewer harmonics",
    "pruning": "pruned",
    "allowance": "auto, loss allowed",
}


def draw_bytes_and_seconds(found: Sequence[Result]) -> Figure:
    """Bytes of the delivered file, and seconds to embed, against its fidelity to the owner's original."""
    drawn, panels = figure(1, 2, width=10.4, height=4.0)
    costs: list[Callable[[Result], float]] = [lambda r: float(r.row["sog_bytes"]) / 1e6, lambda r: r.embed_seconds]
    for axes, cost in zip(panels, costs, strict=True):
        for (axis, label), style in zip(SPENDING.items(), styles(), strict=False):
            own = sorted(_of(found, axis), key=lambda r: float(r.row["psnr_total_held_out"]))
            look = style if axis not in ("profile", "auto") else {**style, "linestyle": "none"}
            axes.plot([cost(r) for r in own], [float(r.row["psnr_total_held_out"]) for r in own], label=label, **look)
            for result in own if axis in ("auto", "allowance") else []:
                at = (cost(result), float(result.row["psnr_total_held_out"]))
                _annotate(axes, result.point.name.replace("allowed-", "") + f", z {result.worst_z:.0f}", at, (5, -9))
        axes.set(ylabel="PSNR against the original, worst unseen view, dB")
    panels[0].set(xlabel="bytes as .sog, MB", title=_spared(found))
    panels[1].set(xlabel="seconds to embed", title="What choosing costs")
    panels[0].legend()
    return drawn


def _spared(found: Sequence[Result]) -> str:
    allowed = [float(result.row["sog_bytes"]) for result in _of(found, "allowance")]
    if not allowed:
        return "What the delivered file takes"
    return f"Down to {100 * min(allowed) / float(found[0].row['sog_bytes']):.0f} % of the bytes by what loss is allowed"


def _of(found: Sequence[Result], axis: str) -> list[Result]:
    return [result for result in found if result.point.axis == axis]


def draw_predictions(predicted: Sequence[Result]) -> Figure:
    """Predicted against measured z of a picture at JPEG quality 10."""
    drawn, axes = figure(width=4.8, height=4.2)
    points = [(float(r.row["predicted_z"]), r.usual_picture_z, str(r.row["scene"])) for r in predicted]
    for scene, style in zip(dict.fromkeys(scene for *_, scene in points), styles(), strict=False):
        own = [(x, y) for x, y, name in points if name == scene]
        axes.plot([x for x, _ in own], [y for _, y in own], label=scene, **{**style, "linestyle": "none"})
    values = [value for point in points for value in point[:2]]
    ends = [0.9 * min(values), 1.1 * max(values)]
    axes.plot(ends, ends, color=INK, linewidth=0.8, zorder=1)
    axes.fill_between(ends, [0.85 * end for end in ends], [1.15 * end for end in ends], color="#eeeeee", zorder=0)
    _annotate(axes, "within 15 %", (ends[0], 1.15 * ends[0]), (0, 0), color="#6a6a6a", va="bottom")
    axes.set(
        xlabel="z predicted by the rehearsal",
        ylabel="z measured, mean of two pictures",
        title=f"Rehearsed before embedding: z within {100 * max(abs(y / x - 1.0) for x, y, _ in points):.0f} %",
    )
    axes.legend()
    return drawn
