"""The chart of speed against accuracy: seconds, bytes and decibels against z after the worst attack."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.special import betainc

from engine.lab.evaluate.figures import FAINT, INK, MARKERS, PALETTE, Axes, Figure, figure, label_line
from engine.lab.evaluate.published import Published
from engine.lab.evaluate.study import Row
from engine.lab.evaluate.summary import scene_name
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE, z_threshold

PICTURE_ATTACKS = ("JPEG 10", "JPEG 50", "noise 0.1", "crop 40 %")
"""Published under these words at 32 bits; a peer's point is the lowest of those it has."""
BITS = 32
TICKS = (2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 300)
"""Of seconds and of z: numbers that read well."""
PAPER = "paper"
"""The setting that is not ours."""


@dataclass(frozen=True)
class Peer:
    """What a method's authors, or others, published of it."""

    name: str
    hardware: str
    blind: bool
    seconds: float  # to embed
    bits: float  # per cent right, of 32, worst attacked picture
    db: float | None
    venue: str
    source: str

    @property
    def z(self) -> float:
        """The z that is as good as so many bits: both bound the chance of a wrong key alike."""
        right = BITS * self.bits / 100.0
        return math.sqrt(-2.0 * math.log(betainc(right, BITS - right + 1.0, 0.5)))


def peers(published: Sequence[Published]) -> list[Peer]:
    """Those that published seconds to embed and 32 bits from attacked pictures."""
    conditions = {f"{BITS} bits, {name}" for name in PICTURE_ATTACKS}
    found = []
    for method in dict.fromkeys(point.method for point in published):
        own = [point for point in published if point.method == method]
        times = [point.value for point in own if point.what == "embedding time"]
        bits = [point.value for point in own if point.what == "bit accuracy" and point.conditions in conditions]
        db = [point.value for point in own if point.what == "PSNR"]
        if times and bits:
            about = own[0]
            name = method.replace(" (the paper)", "")
            said = (about.hardware, about.blind, times[0], min(bits), min(db, default=None), about.venue, about.source)
            found.append(Peer(name, *said))
    return sorted(found, key=lambda peer: peer.seconds)


TIES = (0.02, 0.02, 0.2, 0.02)
"""Differences below which two settings are alike, as a repetition is: of seconds, bytes and z a share, of PSNR dB."""


def dominated(row: Row, rows: Sequence[Row]) -> bool:
    """Whether another setting of the scene is nowhere worse (seconds, bytes, decibels, z) and somewhere better."""
    return any(_beats(other, row) for other in rows if other["scene"] == row["scene"])


def _beats(one: Row, other: Row) -> bool:
    def worth(row: Row) -> tuple[float, ...]:
        return -math.log(row["cpu_seconds"]), -math.log(row["bytes"]), row["psnr_unseen"], math.log(_shown(row))

    better = [(a - b) / tie for a, b, tie in zip(worth(one), worth(other), TIES, strict=True)]
    return min(better) > -1.0 and max(better) > 1.0


def _shown(row: Row) -> float:
    """z as a log scale shows it: 1 and less is what chance gives."""
    return max(1.0, float(row["worst_z"]))


def outdone(peer: Peer, rows: Sequence[Row]) -> bool:
    """Whether one of ours is at least as good in everything that was published."""
    return any(
        row["cpu_seconds"] <= peer.seconds and row["worst_z"] >= peer.z and row["psnr_unseen"] >= (peer.db or 0.0)
        for row in rows
    )


def draw(rows: Sequence[Row], others: Sequence[Peer], machine: str) -> Figure:
    """One page: ours beside what is published, and ours alone by what they cost."""
    title = "What is left after the worst of five attacks, by what it costs: seconds, bytes, decibels"
    drawn, ((beside, by_seconds), (by_bytes, by_db)) = figure(2, 2, width=10.4, height=8.6, title=title)
    _beside(beside, rows, others, machine)
    panels: tuple[tuple[Axes, Callable[[Row], float]], ...] = (
        (by_seconds, lambda row: float(row["cpu_seconds"])),
        (by_bytes, lambda row: 100.0 * row["bytes"] / row["bytes_whole"]),
        (by_db, lambda row: float(row["psnr_unseen"])),
    )
    for axes, cost in panels:
        _ours(axes, rows, cost)
    by_seconds.set(xscale="log", xlabel="processor seconds to embed (log scale)", title=_in_seconds(rows))
    _plain_ticks(by_seconds.xaxis, TICKS)
    by_bytes.set(xlabel="marked file, % of the unmarked one's bytes (.sog)", title=_in_bytes(rows))
    by_db.set(xlabel="PSNR against the original, worst unseen view, dB", title="Decibels: mark and losses together")
    _published(by_db, rows, others, lambda peer: peer.db)
    by_db.set_ylim(3.0)
    _plain_ticks(by_db.yaxis, TICKS)
    _legend(drawn, by_db, rows)
    return drawn


def _legend(drawn: Figure, axes: Axes, rows: Sequence[Row]) -> None:
    scenes, settings = _names(rows, "scene"), _names(rows, "setting")
    for scene, mark in zip(scenes, MARKERS, strict=False):
        axes.plot([], [], mark, markersize=7, color="white", markeredgecolor=INK, label=scene_name(scene))
    for setting, color in zip(settings, PALETTE, strict=False):
        said = "the paper's, run by us" if setting == PAPER else setting.replace("40 dB", "40 dB allowed")
        axes.plot([], [], "s", markersize=8, color=color, label=said)
    ringed: dict[str, Any] = {"markersize": 7, "color": FAINT, "markeredgecolor": INK}
    axes.plot([], [], "s", **ringed, label="dominated, ringed in its color")
    shown = (len(scenes) + len(settings) + 2) // 2
    drawn.legend(loc="outside lower center", ncols=shown, columnspacing=1.4, handletextpad=0.3, fontsize=9)


def _ours(axes: Axes, rows: Sequence[Row], cost: Callable[[Row], float]) -> None:
    scenes, settings = _names(rows, "scene"), _names(rows, "setting")
    for row in sorted(rows, key=lambda row: not dominated(row, rows)):  # grey lies below
        grey, color = dominated(row, rows), PALETTE[settings.index(row["setting"])]
        look: dict[str, Any] = {"markersize": 8, "markeredgecolor": "white", "color": color}
        if grey:
            look = {"markersize": 8, "markeredgecolor": color, "markeredgewidth": 1.2, "color": FAINT}
        axes.plot(cost(row), _shown(row), MARKERS[scenes.index(row["scene"])], **look)
    owner, found = z_threshold(DISHONEST_CLAIMANT_RATE), [_shown(row) for row in rows]
    label_line(axes, owner, "claim at 1 in 2^128", above=False)
    axes.set(yscale="log", ylim=(0.85 * min(owner, *found), 1.3 * max(found)))
    axes.set_ylabel("z after the worst attack (log scale)")
    _plain_ticks(axes.yaxis, TICKS)


def _beside(axes: Axes, rows: Sequence[Row], others: Sequence[Peer], machine: str) -> None:
    _ours(axes, rows, lambda row: float(row["cpu_seconds"]))
    _published(axes, rows, others, lambda peer: peer.seconds)
    kinds = ((f"{peer.name}: {peer.hardware}", "blind" if peer.blind else "informed") for peer in others)
    lines = [f"{number} {name}, {kind}" for number, (name, kind) in enumerate(kinds, start=1)]
    said = "\n".join([f"Filled: run by us, informed, {machine}, no GPU", "Hollow: published", *lines])
    axes.text(0.99, 0.99, said, transform=axes.transAxes, ha="right", va="top", fontsize=8, linespacing=1.35)
    low = min(row["worst_z"] for row in rows if row["setting"] != PAPER)
    axes.set(
        xscale="log",
        xlim=(0.5 * min(row["cpu_seconds"] for row in rows), 2.0 * max(peer.seconds for peer in others)),
        ylim=(3.0, 4.5 * max(row["worst_z"] for row in rows)),
        xlabel="seconds to embed (log scale); filled: processor time",
        title=f"Ours: z {low:.0f} and more; published: z {max(peer.z for peer in others):.1f} and less",
    )
    _plain_ticks(axes.xaxis, (3, 10, 30, 100, 300, 1000, 3000, 10000))


def _published(axes: Axes, rows: Sequence[Row], others: Sequence[Peer], cost: Callable[[Peer], float | None]) -> None:
    label_line(axes, z_threshold(CHANCE_RATE), "1 in 10^9 by chance")
    for number, peer in enumerate(others, start=1):
        if (x := cost(peer)) is not None:
            color = FAINT if outdone(peer, rows) else INK
            axes.plot(x, peer.z, "o" if peer.blind else "D", color="white", markeredgecolor=color, markersize=7)
            above = number % 2 == 0
            look: dict[str, Any] = {"ha": "center", "va": "bottom" if above else "top", "fontsize": 8}
            axes.annotate(str(number), (x, peer.z), xytext=(0, 5 if above else -5), textcoords="offset points", **look)


def _in_seconds(rows: Sequence[Row]) -> str:
    by = {(row["scene"], row["setting"]): row["cpu_seconds"] for row in rows}
    shares = [by[scene, "auto"] / by[scene, "balanced"] for scene, name in by if name == "balanced"]
    return f"Seconds: auto takes {min(shares):.2f} to {max(shares):.2f} of balanced" if shares else "Seconds"


def _in_bytes(rows: Sequence[Row]) -> str:
    least = min((row for row in rows if row["setting"] != PAPER), key=lambda row: row["bytes"] / row["bytes_whole"])
    return f"Bytes: down to {100 * least['bytes'] / least['bytes_whole']:.0f} % at z {least['worst_z']:.0f}"


def _names(rows: Sequence[Row], field: str) -> list[str]:
    return list(dict.fromkeys(row[field] for row in rows))


def _plain_ticks(axis: Any, values: Sequence[int]) -> None:
    low, high = axis.get_view_interval()
    shown = [value for value in values if low <= value <= high]
    axis.set_ticks(shown, [f"{value:,}" for value in shown])
    axis.set_ticks([], minor=True)
