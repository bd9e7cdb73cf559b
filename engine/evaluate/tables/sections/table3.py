"""Table 3: time, frames a second, bytes."""

from typing import Any

from engine.evaluate.study import Bar, Cell, Options, Row, Section, Table
from engine.evaluate.tables.effort import Effort, scenes_of
from engine.evaluate.tables.paper import PUBLISHED, printed
from engine.evaluate.tables.part import CELLS, Part

LARGE = 400_000
"""Gaussians from which a scene speaks for the bars, which are meant for 500k."""
EMBED_BARS, VERIFY_BAR, BYTES_BAR = {"fast": 15.0, "balanced": 45.0}, 3.0, 20.0


def cells(options: Options) -> list[Cell]:
    """Two profiles of every scene."""
    changes = {**Effort.of(options).changes, "landmark_views": 2} if options.quick else {}
    return [
        Cell(
            f"table3-{profile}-{short}",
            f"{CELLS}.costs:measure_costs",
            {
                "scene": path,
                "named_profile": profile,
                "seed": options.seed,
                "repeats": 1 if options.quick else 3,
                "width": 1297,
                "height": 840,
                "changes": changes,
            },
        )
        for short, path in scenes_of(options)
        for profile in (("fast",) if options.quick else ("fast", "balanced"))
    ]


def section(rows: list[Row], options: Options) -> Section:
    """The paper's columns and ours."""
    of = _own(rows)
    ours = [
        [
            row["scene"],
            row["profile"],
            row["gaussians"],
            _seconds(row, "embed"),
            _seconds(row, "verify"),
            f"{row['fps_before']:.1f}",
            f"{row['fps_after']:.1f}",
            _mb(row["bytes"]["ply"]),
            _mb(row["bytes"]["sog"]),
            _mb(row["compact_sog_bytes"]),
            row["compact_sog_bytes"] / row["gaussians"],
            f"{row['compact_psnr']:.1f}",
        ]
        for row in of
    ]
    columns = (
        "scene",
        "profile",
        "Gaussians",
        "embed, s",
        "verify a model, s",
        "frames/s before",
        "and after",
        "PLY, MB",
        ".sog, MB",
        "compact .sog, MB",
        "its bytes a Gaussian",
        "its worst view, dB",
    )
    every = [
        [row["scene"], *(row["bytes"][kind] / row["gaussians"] for kind in row["bytes"])]
        for row in of
        if row["profile"] == "fast"
    ]
    names = tuple(f".{kind}" for kind in of[0]["bytes"]) if of else ()
    theirs = [
        [row["system"], f"{row['training_seconds'] / 60:.1f}", row["fps"], row["megabytes"]]
        for row in printed("table3")
    ]
    return Section(
        "Table 3: time, frames a second, size",
        [
            "Ours: on this machine's CPU, medians of the repeats with the extremes in brackets; frames of 1297 x "
            "840 pixels from one view. The mark changes colours only, so what is drawn costs the same before and "
            "after. Times hold on a machine that does nothing else.",
            PUBLISHED
            + " Its time is one of training a marked model from photographs on an RTX 4090, its frames a second "
            "are a GPU's, its size is that of an uncompressed file: none of the three is the same question as ours.",
        ],
        [
            Table(columns, ours, "Ours"),
            Table(("scene", *names), every, "Bytes a Gaussian in each format, marked, no bands or codes dropped"),
            Table(("system", "training, minutes", "frames/s", "MB"), theirs, "As the paper prints it"),
        ],
    )


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """Time on large scenes, bytes on all."""
    of = _own(rows)
    if not of:
        return []
    made: list[Bar] = []
    for profile, most in EMBED_BARS.items():
        if any(row["profile"] == profile for row in of):
            made.append(_timed(of, "embed", f"embed 500k Gaussians, {profile}", most, profile))
    made.append(_timed(of, "verify", "verify a model of 500k Gaussians", VERIFY_BAR, "fast"))
    for row in (row for row in of if row["profile"] == "fast"):
        size = row["compact_sog_bytes"] / row["gaussians"]
        made.append(
            Bar(
                f"file of {row['scene']}, compact, .sog",
                f"<= {BYTES_BAR:g} bytes a Gaussian",
                f"{size:.1f}",
                size <= BYTES_BAR,
            )
        )
    return made


def _timed(rows: list[Row], what: str, name: str, most: float, profile: str) -> Bar:
    large = [row for row in rows if row["profile"] == profile and row["gaussians"] >= LARGE]
    if not large:
        biggest = max(row["gaussians"] for row in rows)
        said = f"no scene of {LARGE:,} Gaussians or more in this run; largest {biggest:,}"
        return Bar(name, f"<= {most:g} s on 2 cores", said, None)
    slowest = max(large, key=lambda row: float(row[what]))
    said = f"{slowest[what]:.1f} s ({slowest['scene']}, {slowest['gaussians']:,} Gaussians; this machine)"
    return Bar(name, f"<= {most:g} s on 2 cores", said, bool(slowest[what] <= most))


def _own(rows: list[Row]) -> list[Row]:
    return [row for row in rows if "fps_after" in row]


def _seconds(row: Row, what: str) -> str:
    return f"{row[what]:.1f} ({row[f'{what}_least']:.1f} to {row[f'{what}_most']:.1f})"


def _mb(size: Any) -> str:
    return f"{size / 1e6:.1f}"


PART = Part(
    "table3",
    "Table 3: time, frames a second, size",
    "How long does it take, how fast does it draw, how large is it?",
    cells,
    section,
    bars,
)
