"""One figure for each attack family that matters: bits right by strength, ours beside other methods, and where each
breaks: `python -m engine.lab.evaluate.stability.attack_families CURVES FIGURE RESULT`.

CURVES is what `mark3dgs evaluate --suite stability --setting families` leaves as `attack_families.json`; FIGURE is a
PNG of it, RESULT a file of docs/results.
"""

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from engine.lab.evaluate.benchmark.methods import BITS, LEAST_MATCHES, OURS
from engine.lab.evaluate.figures import FAINT, INK, Figure, figure, house_style, label_line, png, styles
from engine.lab.evaluate.stability.stability_curves import Break, breaking_point, first_below, strength_at
from engine.lab.evaluate.stability.sweeps import PICTURE_DB
from engine.lab.evaluate.study import Row
from engine.lab.evaluate.summary import distinct, grouped, picked, scene_name
from engine.model import Float64

__all__ = ["FAMILIES", "READING", "draw_families", "family_curves", "family_result", "main"]

FAMILIES = {
    "crop": "Model, one piece: share kept",
    "noise_all": "Model, noise on all: deviations",
    "lod": "Model, voxels merged: share kept",
    "jpeg": "Picture, JPEG: quality",
    "blur": "Picture, blur: sigma, pixels",
    "denoise_nonlocal": "Picture, non-local means: levels",
}
"""Sweeps by what they do: cutting, noise and simplification of models; coding, filtering and denoising of pictures."""
READING = {
    OURS: ("ours", "informed"),
    "qim": ("QIM", "blind"),
    "spread": ("spread spectrum", "informed"),
    "dct": (f"DCT at {PICTURE_DB:g} dB", "blind"),
}
"""Names of the methods, and whether reading them uses the unmarked original."""
CLAIM_LOST: dict[str, Any] = {"color": INK, "linestyle": ":", "linewidth": 1.2}
LEAST_BITS = LEAST_MATCHES / BITS
"""Where a method breaks: what the field's usual test at 1e-3 requires."""


def family_curves(rows: Sequence[Row]) -> list[Row]:
    """One entry for each family, scene and method: strengths, a curve of bits for each trial; of ours z and dB, too."""
    entries: list[Row] = []
    for (family, scene), own in grouped(_whole(rows), "attack", "scene").items():
        steps = grouped(own, "step")
        about = {"family": family, "scene": scene, "strengths": [steps[k][0]["strength"] for k in sorted(steps)]}
        trials = [sorted(trial, key=lambda row: row["step"]) for trial in grouped(own, "trial").values()]
        looks = [[row["psnr"] for row in trial] for trial in trials if all("psnr" in row for row in trial)]
        # Where nothing is read, chance has half of the bits, as of the methods that always guess.
        read = {"bits": [[row["bits"] or 0.5 for row in trial] for trial in trials]}
        read["z"] = [[round(row["z"], 2) for row in trial] for trial in trials]
        threshold = max(row["z_threshold"] for row in own)
        mean_look = [round(float(look), 1) for look in np.mean(looks, axis=0)] if looks else None
        entries.append({**about, "method": OURS, **read, "z_threshold": threshold, "psnr": mean_look})
        for method in READING:
            curves = [[row.get(f"bits_{method}") for row in trial] for trial in trials]
            if known := [curve for curve in curves if None not in curve]:
                entries.append({**about, "method": method, "bits": known})
    return entries


def _whole(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if "z" in row and row.get("attack") in FAMILIES and row["reading"] == "literal"]


def _broken(entries: Sequence[Row], field: str, level: float) -> Break:
    """Where the mean of all trials of all scenes falls below a level."""
    return breaking_point(np.concatenate([np.array(entry[field], np.float64) for entry in entries]), level)


def _threshold(ours: Sequence[Row]) -> float:
    """z that a claim at 1 in 10^9 needs, where most hypotheses were tested."""
    return float(max(entry["z_threshold"] for entry in ours))


def _worst(ours: Sequence[Row]) -> Row:
    """The scene whose claim goes first; where none goes, the one with the least z at the end."""

    def rank(entry: Row) -> tuple[float, float]:
        z = np.mean(entry["z"], axis=0)
        return first_below(z, entry["z_threshold"]), float(z[-1])

    return min(ours, key=rank)


def draw_families(entries: Sequence[Row]) -> Figure:
    """Small multiples: a panel a family, a line a method; bars lie where a method breaks, as long as the interval."""
    families = [family for family in FAMILIES if picked(entries, family=family)]
    title = "Where each method breaks: 32 bits right, mean of the scenes; bars: 95 % interval of the breaking point"
    rows = -(-len(families) // 3)
    drawn, axes = figure(rows, 3, width=10.4, height=0.9 + 3.1 * rows, title=title, squeeze=False)
    looks = dict(zip(READING, styles(), strict=False))
    looks[OURS]["zorder"] = 3.0  # where curves coincide, ours lies on top, smaller
    for method in set(looks) - {OURS}:
        looks[method]["markersize"] = 7
    for panel, family in zip(axes.flat, families, strict=False):
        own = picked(entries, family=family)
        for method, few in grouped(own, "method").items():
            look, broken = looks[method], _broken(few, "bits", LEAST_BITS)
            curves = np.concatenate([np.array(entry["bits"], np.float64) for entry in few])
            panel.plot(100.0 * curves.mean(axis=0), label=", ".join(READING[method]), **look)
            if broken.lost:
                ends = broken.low - 0.02, min(broken.high, curves.shape[1] - 1.0) + 0.02
                panel.hlines(100.0 * LEAST_BITS, *ends, color=look["color"], linewidth=5.0, alpha=0.45)
        ours = picked(own, method=OURS)
        worst, claim = _worst(ours), _broken(ours, "z", _threshold(ours))
        if claim.lost:
            panel.axvline(claim.step, **CLAIM_LOST)
        panel.plot(100.0 * np.mean(worst["bits"], axis=0), color=looks[OURS]["color"], linewidth=0.8, alpha=0.7)
        strengths = worst["strengths"]
        panel.set_xticks(range(len(strengths)), [f"{value:g}" for value in strengths])
        panel.set(
            ylim=(40.0, 103.0), title=FAMILIES[family], xlabel=f"ours: worst scene {scene_name(worst['scene'])} (thin)"
        )
        label_line(panel, 100.0 * LEAST_BITS, "")
    for panel in axes[:, 0]:
        panel.set_ylabel("bits right, %")
    for panel in axes.flat[len(families) :]:
        panel.set_axis_off()
    for method, look in looks.items():
        axes.flat[-1].plot([], [], label=", ".join(READING[method]), **look)
    lines = {line.get_label(): line for line in axes.flat[-1].lines if not str(line.get_label()).startswith("_")}
    lines[f"{LEAST_MATCHES} of {BITS} bits: broken below"] = axes.flat[-1].plot([], [], "--", color=FAINT)[0]
    lines["our claim at 1 in 10^9 is lost"] = axes.flat[-1].plot([], [], **CLAIM_LOST)[0]
    drawn.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=3, fontsize=9)
    return drawn


def family_result(kept: dict[str, Any]) -> Row:
    """The curves as a file of docs/results."""
    entries = kept["curves"]
    methods = [method for method in READING if picked(entries, method=method)]
    columns = [f"{name}, {reading}" for name, reading in (READING[method] for method in methods)]
    lines = []
    for family in distinct(sorted(entries, key=lambda entry: list(FAMILIES).index(entry["family"])), "family"):
        own = picked(entries, family=family)
        ours = picked(own, method=OURS)
        worst, threshold = _worst(ours), _threshold(ours)
        claim = _broken(ours, "z", threshold)
        cells = [_said(picked(own, method=method), "bits", LEAST_BITS) for method in methods]
        least = np.mean(worst["z"], axis=0)[-1]
        end = f"z {least:.1f} at {worst['strengths'][-1]:g}"
        at = f"{scene_name(worst['scene'])}: {_said([worst], 'z', threshold)}, {end}"
        lines.append([FAMILIES[family], _said(ours, "z", threshold) + _look(ours, claim.step), *cells, at])
    return {
        **{name: kept[name] for name in ("command", "seed", "machine", "commit")},
        "what": "Where each method breaks",
        "columns": [
            "attack",
            "our claim is lost at",
            *(f"bits: {column}" for column in columns),
            "worst scene of ours",
        ],
        "rows": lines,
        "notes": [
            f"[Figure](attack_families.png). {', '.join(map(scene_name, distinct(entries, 'scene')))}; means, "
            "and in brackets 95 % intervals over resampled trials, which are few; between two strengths that were "
            f"tried a curve may fall anywhere. Claims are at 1 in 10^9, bits break below {LEAST_MATCHES} of {BITS}. "
            "The other methods stand for their class and were run by us, those for models at our PSNR, the one for "
            f"pictures at {PICTURE_DB:g} dB and 512 pixels in a view that it was fitted to, else it does not read its "
            "own renders. Ours has profile `fast` and pictures of 400 pixels, camera known; its reading is informed. "
            "Blind methods solve a harder problem."
        ],
    }


def _said(entries: Sequence[Row], field: str, level: float) -> str:
    """The breaking point as a strength, with its interval."""
    if not entries:
        return "-"
    strengths, broken = entries[0]["strengths"], _broken(entries, field, level)
    if not broken.lost:
        return "never"
    if broken.step == 0.0:
        return f"{strengths[0]:g} (the mildest)"
    at, low, high = (_strength(strengths, step) for step in (broken.step, broken.low, broken.high))
    return at if low == high else f"{at} ({low} to {high})"


def _strength(strengths: Sequence[float], step: float) -> str:
    return f"{strength_at(strengths, step):.2g}" if math.isfinite(step) else "the end"


def _look(ours: Sequence[Row], step: float) -> str:
    """What is left of the look where the claim goes."""
    looks = [entry["psnr"] for entry in ours if entry["psnr"]]
    if not looks or not math.isfinite(step):
        return ""
    mean: Float64 = np.mean(looks, axis=0)
    return f", {np.interp(step, np.arange(len(mean)), mean):.0f} dB"


def main(arguments: list[str]) -> int:
    """Draw the figure and write the result; exit code 2 for wrong usage."""
    if len(arguments) != 3:
        sys.stderr.write("usage: python -m engine.lab.evaluate.stability.attack_families CURVES FIGURE RESULT\n")
        return 2
    curves, drawing, result = map(Path, arguments)
    kept = json.loads(curves.read_text(encoding="utf-8"))
    with house_style():
        drawing.write_bytes(png(draw_families(kept["curves"])))
    result.write_text(json.dumps(family_result(kept), indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
