"""Table 3: time, frames a second, bytes."""

from typing import Any

from engine.lab.evaluate.study import Bar, Cell, Options, Row, Section
from engine.lab.evaluate.summary import picked, table
from engine.lab.evaluate.tables.part import MEASURING, PUBLISHED, Part, changes_of, printed_table, scenes_of

LARGE = 400_000
"""Gaussians from which a scene counts for the bars, which are meant for 500k."""
EMBED_BARS, VERIFY_BAR, BYTES_BAR = {"fast": 15.0, "balanced": 45.0}, 3.0, 20.0


def cells(options: Options) -> list[Cell]:
    """Two profiles of every scene."""
    changes = {**changes_of(options), "landmark_views": 2} if options.quick else {}
    shared = {
        "seed": options.seed,
        "repeats": 1 if options.quick else 3,
        "width": 1297,
        "height": 840,
        "changes": changes,
    }
    return [
        Cell(f"table3-{profile}-{short}", f"{MEASURING}:measure_costs", {"scene": path, "profile": profile, **shared})
        for short, path in scenes_of(options)
        for profile in (("fast",) if options.quick else ("fast", "balanced"))
    ]


def section(rows: list[Row], options: Options) -> Section:
    """The paper's columns and ours."""
    of = _own(rows)
    ours = table(
        of,
        "scene",
        "profile",
        ("Gaussians", "gaussians"),
        ("embed, s", "{embed:.1f} ({embed_least:.1f} to {embed_most:.1f})"),
        ("verify a model, s", "{verify:.1f} ({verify_least:.1f} to {verify_most:.1f})"),
        ("frames/s before", "{fps_before:.1f}"),
        ("and after", "{fps_after:.1f}"),
        ("PLY, MB", lambda row: _mb(row["bytes"]["ply"])),
        (".sog, MB", lambda row: _mb(row["bytes"]["sog"])),
        ("compact .sog, MB", lambda row: _mb(row["compact_sog_bytes"])),
        ("its bytes a Gaussian", _compact),
        ("its worst view, dB", "{compact_psnr:.1f}"),
        title="Ours",
    )
    fast = picked(of, profile="fast")
    each = table(
        [{"scene": row["scene"], **{k: size / row["gaussians"] for k, size in row["bytes"].items()}} for row in fast],
        "scene",
        *((f".{kind}", kind) for kind in (of[0]["bytes"] if of else ())),
        title="Bytes a Gaussian in each format, marked, no bands or codes dropped",
    )
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
            ours,
            each,
            printed_table(
                "table3",
                "system",
                ("training, minutes", lambda row: f"{row['training_seconds'] / 60:.1f}"),
                ("frames/s", "fps"),
                ("MB", "megabytes"),
            ),
        ],
    )


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """Time on large scenes, bytes on all."""
    of = _own(rows)
    if not of:
        return []
    made: list[Bar] = []
    for profile, most in EMBED_BARS.items():
        if picked(of, profile=profile):
            made.append(_timed(of, "embed", f"embed 500k Gaussians, {profile}", most, profile))
    made.append(_timed(of, "verify", "verify a model of 500k Gaussians", VERIFY_BAR, "fast"))
    for row in picked(of, profile="fast"):
        what, size = f"file of {row['scene']}, compact, .sog", _compact(row)
        made.append(Bar(what, f"<= {BYTES_BAR:g} bytes a Gaussian", f"{size:.1f}", size <= BYTES_BAR))
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


def _compact(row: Row) -> float:
    return float(row["compact_sog_bytes"] / row["gaussians"])


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
