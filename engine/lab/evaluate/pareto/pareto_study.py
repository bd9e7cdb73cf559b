"""The study `pareto`: what each profile costs in seconds, bytes and decibels, and what is left of it after attacks.

One cell is one setting on one scene. A scene of 100,000 Gaussians takes about 300 processor seconds.
"""

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.machine import machine_info
from engine.lab.evaluate.pareto.pareto_cells import ATTACKS, PICTURES, QUICK, SETTINGS, UNSEEN, measure_setting
from engine.lab.evaluate.pareto.pareto_charts import PAPER, dominated, draw, outdone, peers
from engine.lab.evaluate.published import read_published
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import grouped, scene_name, table

MOST_OF_FAST, MOST_OF_BALANCED = 1.15, 1.0
"""Processor seconds that `auto` may take, in those of the other profile."""

SPENT, LEAST_SPENT = "auto, 40 dB", 39.0
"""Views that had no part in pruning and recovery keep what was allowed, but for 1 dB."""


def _cells(options: Options) -> list[Cell]:
    return [
        Cell.of(
            f"{number}-{scene_name(scene)}-{setting.replace(', ', '-').replace(' ', '')}",
            measure_setting,
            scene=scene,
            setting=setting,
            seed=options.seed,
            quick=options.quick,
        )
        for number, scene in enumerate(options.scenes)
        for setting in (QUICK if options.quick else SETTINGS)
    ]


def _report(rows: list[Row], options: Options) -> Report:
    others = peers(read_published())
    measured = table(
        rows,
        "scene",
        "setting",
        ("processor s", "cpu_seconds"),
        ("bytes, .sog", "bytes"),
        ("unmarked", "bytes_whole"),
        ("Gaussians", "gaussians_out"),
        ("dB, unseen views", "psnr_unseen"),
        ("dB of the mark", "psnr_of_mark"),
        *((f"z, {trial.label}", partial(_z_after, trial.label)) for trial in ATTACKS),
        ("bits right %, worst", lambda row: 100.0 * row["bits_right"]),
        ("dominated", lambda row: "yes" if dominated(row, rows) else ""),
        title="Measured",
    )
    published = table(
        others,
        ("method", lambda peer: peer.name),
        ("venue", lambda peer: peer.venue),
        ("embed s", lambda peer: peer.seconds),
        ("bits right %, worst picture", lambda peer: peer.bits),
        ("as z", lambda peer: peer.z),
        ("PSNR dB", lambda peer: peer.db),
        ("reads", lambda peer: "blind" if peer.blind else "informed"),
        ("hardware", lambda peer: peer.hardware),
        ("dominated", lambda peer: "yes" if outdone(peer, rows) else ""),
        ("source", lambda peer: peer.source),
        title="Published, other hardware and scenes",
    )
    machine = machine_info()
    drawing = Drawing("pareto", partial(draw, rows, others, _here(machine)), HOW)
    section = Section("Seconds, bytes and decibels against z", [HOW, *NOTES], [measured, published], [drawing])
    page = json.dumps(_result(rows, options, machine), indent=1) + "\n"
    return Report(_bars(rows), [section], pages={PAGE: page})


def _here(machine: dict[str, Any]) -> str:
    return f"{machine['cores_usable']} cores of {machine['cpu']}"


def _z_after(attack: str, row: Row) -> float:
    return float(row["z"][attack])


PAGE = "17_profiles.json"
"""What docs/results keeps of a run."""
HOW = (
    "Filled: run by us, informed; `paper` is the paper's system; the lowest z of five attacks (models cropped to 10 %, "
    "with noise of 0.1 on everything, through .splat; pictures of 800 x 800 at JPEG 10 and with noise of 0.1, camera "
    "known), one key. Hollow: published, with hardware as named; circles blind, a diamond informed: z for which a "
    "wrong key is as improbable as for the bits that they report, of 32, from their worst attacked picture."
)
NOTES = (
    "Grey points, ringed in their setting's color, are dominated: another setting of the scene is at least as good in "
    "seconds, bytes, decibels and z and better in one; of a published method, one of ours is at least as good in "
    "all that was published.",
    "Blind methods solve a harder problem, and seconds of other hardware are no measure of ours.",
    f"Decibels are of mark and losses together, against the original, in the worst of {UNSEEN} views that no key view "
    f"was; the first {PICTURES} of them are attacked. Bytes are of the marked model as .sog.",
)


def _bars(rows: Sequence[Row]) -> list[Bar]:
    """Of all scenes together."""
    ours = [row for row in rows if row["setting"] != PAPER]
    torn = [row for row in ours if row["bits_right"] < 1.0]
    low, high = share_interval(len(ours) - len(torn), len(ours))
    said = f"{len(ours) - len(torn)} of {len(ours)} (95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    faults = [f"{row['setting']} on {scene_name(row['scene'])} {100 * row['bits_right']:.0f} %" for row in torn]
    bars = [Bar.without("settings of ours keep every bit after every attack", "all", said, faults)]
    seconds = {(row["scene"], row["setting"]): row["cpu_seconds"] for row in rows}
    for other, most in (("fast", MOST_OF_FAST), ("balanced", MOST_OF_BALANCED)):
        shares = {
            f"{scene_name(scene)} {used / seconds[scene, other]:.2f}": used / seconds[scene, other]
            for (scene, setting), used in seconds.items()
            if setting == "auto" and (scene, other) in seconds
        }
        what, met = f"processor seconds of auto, in those of {other}", max(shares.values(), default=0.0) <= most
        bars.append(Bar(what, f"<= {most:g}", ", ".join(shares) + " (one run each)", met if shares else None))
    spent = {scene_name(row["scene"]): row["psnr_unseen"] for row in rows if row["setting"] == SPENT}
    seen, kept = ", ".join(f"{scene} {db:.1f}" for scene, db in spent.items()), min(spent.values(), default=0.0)
    bars.append(
        Bar(f"dB of {SPENT}, worst unseen view", f">= {LEAST_SPENT:g}", seen, kept >= LEAST_SPENT if spent else None)
    )
    return bars


COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("embed, processor s", lambda row: f"{row['cpu_seconds']:.1f}"),
    ("worst z", lambda row: f"{row['worst_z']:.0f}"),
    ("bits of the worst attack", lambda row: f"{100 * row['bits_right']:.0f} %"),
    ("bytes (.sog) of the unmarked", lambda row: f"{100 * row['bytes'] / row['bytes_whole']:.0f} %"),
    ("unseen views, dB", lambda row: f"{row['psnr_unseen']:.1f}"),
)


def _result(rows: Sequence[Row], options: Options, machine: dict[str, Any]) -> dict[str, Any]:
    """The run as a file of docs/results (`engine.lab.evaluate.results_page`)."""
    scenes = [scene_name(scene) for scene in dict.fromkeys(row["scene"] for row in rows)]
    return {
        "what": "Profiles: speed against accuracy",
        "command": "make results SCENES='" + " ".join(Path(scene).name for scene in options.scenes) + "'",
        "seed": str(options.seed),
        "machine": f"{_here(machine)}, shared",
        "commit": "not recorded",
        "columns": ["setting", *(name for name, _ in COLUMNS)],
        "rows": [
            [setting + _some(own, scenes), *(_listed([cell(row) for row in own]) for _, cell in COLUMNS)]
            for setting, own in grouped(rows, "setting").items()
        ],
        "bars": [{"bar": f"{bar.what}: {bar.wanted}", "measured": bar.measured, "met": bar.met} for bar in _bars(rows)],
        "notes": [f"{' / '.join(scenes)}. {HOW}"],
    }


def _some(own: Sequence[Row], scenes: Sequence[str]) -> str:
    """Which scenes a line is of, where it is not of all."""
    measured = [scene_name(row["scene"]) for row in own]
    return "" if len(measured) == len(scenes) else f" ({', '.join(measured)})"


def _listed(cells: Sequence[str]) -> str:
    return cells[0] if len(set(cells)) == 1 else " / ".join(cells)


STUDY = Study("pareto", "Speed against accuracy", "What does each profile cost, and what does it buy?", _cells, _report)
