"""Suite 2: every attack from harmless to ruinous, odd inputs, and the same claim each time.

Full: about 90 sweeps of up to 5 strengths with 3 trials on models (each a key and a seed of its own) and 2 on pictures,
27 odd inputs in two roles, 4 child processes: about 25 minutes a scene of 100k Gaussians on 2 cores. Quick: three
sweeps, five odd inputs, one trial, small views. `--setting families`: the six sweeps of `attack_families` alone.
"""

import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from engine.errors import InputError
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.machine import machine_info
from engine.lab.evaluate.stability.attack_families import FAMILIES, draw_families, family_curves
from engine.lab.evaluate.stability.odd_inputs import ODD, QUICK, stress
from engine.lab.evaluate.stability.sameness import compare_machines, compare_precision
from engine.lab.evaluate.stability.stability_curves import Break, Swept, draw_map, failing_first, sum_up
from engine.lab.evaluate.stability.sweeps import PICTURE_SIZE, all_sweeps, sweep, thinned
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import listed, picked, table
from engine.lab.sim.attack_cost import CHEAP_DB

__all__ = ["STUDY"]

MODEL_TRIALS, IMAGE_TRIALS = 3, 2
ONLY_FAMILIES = "families"
"""The part of the suite that `--setting` names."""
QUICK_SWEEPS = ("prune_random", "noise_dc", "jpeg")
ODD_A_CELL = 5


def cells(options: Options) -> list[Cell]:
    """One cell for each sweep and scene; odd inputs a handful at a time; two cells of sameness."""
    if unknown := set(options.settings) - {ONLY_FAMILIES}:
        raise InputError(f"the suite has no part {sorted(unknown)[0]!r}; it has {ONLY_FAMILIES!r}")
    made = []
    names = list(QUICK if options.quick else ODD)
    wanted = FAMILIES if options.settings else QUICK_SWEEPS if options.quick else None
    for number, path in enumerate(options.scenes):
        common = {"path": path, "quick": options.quick, "seed": options.seed}
        for one in all_sweeps():
            strengths, trials = one.strengths, MODEL_TRIALS if one.kind == "model" else IMAGE_TRIALS
            if options.quick:
                strengths, trials = thinned(strengths, 3), 1
            if wanted is None or one.name in wanted:
                swept = {"attack": one.attack, "kind": one.kind, "reading": one.reading, "strengths": list(strengths)}
                made.append(Cell.of(f"{number}-{one.name}", sweep, **common, **swept, trials=trials))
        if options.settings:
            continue
        made.append(Cell.of(f"{number}-same-precision", compare_precision, **common))
        made.append(Cell.of(f"{number}-same-machines", compare_machines, **common))
        for part in range(0, len(names), ODD_A_CELL):
            few = names[part : part + ODD_A_CELL]
            made.append(Cell.of(f"{number}-odd-{part // ODD_A_CELL}", stress, **common, names=few))
    return made


def report(rows: list[Row], options: Options) -> Report:
    """Misses first: attacks that take the claim and keep the look, odd inputs at fault, answers that differ."""
    swept = failing_first(sum_up(rows))
    models, pictures = ([one for one in swept if one.kind == kind] for kind in ("model", "image"))
    odd, same = picked(rows, what="stress"), picked(rows, what="same")
    refused = [row for row in picked(rows, what="sweep") if "refused" in row]
    curves = family_curves(rows)
    sections = [_attack_section(models, "model", refused), _attack_section(pictures, "image", refused)]
    sections += [] if options.settings else [_odd_section(odd), _same_section(same)]
    families = Drawing("attack-families", partial(draw_families, curves), "Blind methods solve a harder problem.")
    return Report(
        [
            _attack_bar(models, "models"),
            _attack_bar(pictures, "one picture"),
            *([] if options.settings else [_input_bar(odd), *_same_bars(same)]),
        ],
        [Section("Attack families", drawings=[families]), *sections],
        answer=[_answer(models, "models"), _answer(pictures, f"a single picture of {PICTURE_SIZE} pixels")],
        summary={
            "sweeps": len(swept),
            "claims_lost": [one.name for one in swept if one.claim_break.lost],
            "bits_lost": [one.name for one in swept if one.bits_break.lost],
            "claims_lost_cheaply": [one.name for one in swept if one.is_cheap],
        },
        pages={"attack_families.json": _kept(curves, options)},
    )


def _kept(curves: Sequence[Row], options: Options) -> str:
    """What docs/results/curves keeps of a run, a line a curve."""
    machine = machine_info()
    scenes = " ".join(f"--scene {Path(scene).name}" for scene in options.scenes)
    about = {
        "command": f"mark3dgs evaluate --suite stability --setting {ONLY_FAMILIES} {scenes}",
        "seed": str(options.seed),
        "machine": f"{machine['cores_usable']} cores of {machine['cpu']}, shared",
        "commit": "not recorded",
    }
    said = ",\n".join(f"  {json.dumps(curve)}" for curve in curves)
    return json.dumps(about, indent=1)[:-2] + f',\n "curves": [\n{said}\n ]\n}}\n'


def _answer(own: Sequence[Swept], what: str) -> str:
    lost, cheap = sum(one.claim_break.lost for one in own), [one.name for one in own if one.is_cheap]
    return (
        f"Of {len(own)} sweeps on {what}, {len(own) - lost} never take the claim at 1e-9; {lost} do "
        f"at some strength, {len(cheap)} of them before the attacker has paid with the look "
        f"({CHEAP_DB:g} dB){': ' + ', '.join(cheap) if cheap else ''}."
    )


def _attack_bar(own: Sequence[Swept], what: str) -> Bar:
    cheap = [one.name for one in own if one.is_cheap]
    low, high = share_interval(len(cheap), len(own))
    measured = f"{len(cheap)} of {len(own)} (95 % of the like: {100 * low:.0f} to {100 * high:.0f} %)"
    promise = f"sweeps on {what} that take the claim and keep {CHEAP_DB:g} dB"
    return Bar.without(promise, "none", measured, cheap) if own else Bar(promise, "none", measured, None)


def _input_bar(odd: Sequence[Row]) -> Bar:
    faults, same = picked(odd, outcome="fault"), len(picked(odd, outcome="same"))
    measured = f"{len(faults)} of {len(odd)} at fault; {same} answer alike, {len(odd) - same - len(faults)} refused"
    words = [f"{row['input']} ({row['role']}): {row['words']}" for row in faults]
    promise = "odd inputs: the same claim each time or a plain refusal"
    return Bar.without(promise, "0 faults", measured, words)


def _same_bars(same: Sequence[Row]) -> list[Bar]:
    bytewise = [row for row in same if not row["how"].startswith(("every number", "seed", "processor"))]
    bars = []
    for promise, rows, field in (
        ("again, from float64, by other numbers of threads: the same bytes of the claim", bytewise, "exact"),
        ("seeds, rounding, processors: the same verdict and bits, z within 0.1 %", same, "close"),
    ):
        differ = [row["how"] for row in rows if not row[field]]
        bars.append(Bar.without(promise, "all", f"{len(rows) - len(differ)} of {len(rows)}", differ))
    return bars


def _attack_section(own: Sequence[Swept], kind: str, refused: Sequence[Row]) -> Section:
    what = "models" if kind == "model" else "one picture"
    missing = sorted({f"{row['attack']}: {row['refused']}" for row in picked(refused, kind=kind)})
    text = [
        "Rows are sorted by how well the attacker still looks when the claim goes; names end in as_code where "
        "public code does something else than the papers say, and in up or down where strengths go both ways. "
        "Strengths are interpolated along the sweep; intervals come from resampled trials (scenes, keys, seeds"
        f"{', views' if kind == 'image' else ''}), exact ones from shares. Few trials give rough intervals; between "
        "two strengths that were tried a curve may fall anywhere."
    ]
    if kind == "model":
        text.append(
            "The Gaussians were read; where they gave no claim, the renders were looked at once (column by looking). "
            "QIM and spread spectrum carry the same message at the same PSNR and were read after the same attack; "
            "QIM is blind. Our reading is informed."
        )
    if missing:
        text.append("Not run: " + "; ".join(missing) + ".")
    lost = sum(one.claim_break.lost for one in own)
    drawings = [
        Drawing(
            f"map-{kind}",
            partial(draw_map, own, f"{len(own) - lost} of {len(own)} attacks on {what} never take the claim"),
            f"Attacks on {what}, failing first, each from its harmless to its ruinous strength. Dark is lost; white "
            "was not measured.",
        )
    ]
    shown = listed([_line(one) for one in own], "Failing first")
    return Section(f"Attacks on {what}", text, [shown], drawings if own else ())


def _line(one: Swept) -> Row:
    """Of the table of attacks."""
    bits, claim, last = one.bits_break, one.claim_break, len(one.strengths) - 1
    at, end = (claim.step, "") if claim.lost else (last, " (end)")
    look, left = one.psnr_at(at), one.coverage_at(at)
    low, high = one.z_interval(last)
    least, most = one.claims_interval(last)
    claims = f"{int(one.claimed[:, -1].sum())} of {len(one.claimed)}"
    return {
        "attack": one.name,
        "bits below 99 % at": _where(one, bits),
        "claim lost at": _where(one, claim),
        "PSNR by then, dB": None if look is None else f"{look:.1f}{end}",
        "covered by then": None if left is None else f"{100 * left:.0f} %",
        "grid ends at": f"{one.strengths[-1]}",
        "bits there": f"{100 * one.bits[:, -1].mean():.1f} %",
        "z there (95 %)": f"{one.z[:, -1].mean():.1f} ({low:.1f} to {high:.1f})",
        "claims there (95 %)": f"{claims} ({100 * least:.0f} to {100 * most:.0f} %)",
        "by looking": "; ".join(f"z {z:.1f} at {strength}" for strength, z in one.by_looking.items()),
    }


def _where(one: Swept, broken: Break) -> str:
    if not broken.lost:
        return "never"
    if not one.ordered:
        return str(one.strength_of(broken.step))
    if broken.step == 0.0:
        return f"{one.strengths[0]} (the mildest)"
    upper = f"{one.strength_of(broken.high):.3g}" if math.isfinite(broken.high) else "the end"
    before, after = one.strengths[math.ceil(broken.step) - 1], one.strengths[math.ceil(broken.step)]
    trials = f"trials: {one.strength_of(broken.low):.3g} to {upper}"
    return f"{one.strength_of(broken.step):.3g} (between {before} and {after}; {trials})"


def _odd_section(odd: Sequence[Row]) -> Section:
    text = (
        "Each odd input was made of a connected fifth of the scene, written to a PLY, read back (readers repair what "
        "is harmless), marked, opened and verified twice (role marked); and made of a marked model and verified "
        "against its sound record (role suspect). A RuntimeWarning counts as a fault, and so does an own mark not "
        "found or an unmarked model claimed."
    )
    outcomes = {"same": "answers", "refused": "refused", "fault": "FAULT"}
    shown = table(
        sorted(odd, key=lambda row: row["outcome"] != "fault"),
        "input",
        "role",
        ("what happened", lambda row: outcomes[row["outcome"]]),
        "verdict",
        "z",
        ("without its mark", "unmarked_verdict"),
        "words",
    )
    return Section("Odd inputs", [text], [shown])


def _same_section(same: Sequence[Row]) -> Section:
    text = (
        "A suspect cut to half, moved, shuffled and noised is verified again and again; children mark anew as well. "
        "Only this machine was at hand: another processor is played by compiling without AVX."
    )
    shown = table(
        same,
        "how",
        ("same bytes", lambda row: "yes" if row["exact"] else "no"),
        ("same answer", lambda row: "yes" if row["close"] else "no"),
        ("z of the model", "z_model"),
        ("z of a picture", "z_image"),
        ("claim, model", "model_digest"),
        ("claim, picture", "image_digest"),
        ("marked model", "marked_digest"),
    )
    return Section("The same answer each time", [text], [shown])


STUDY = Study(
    "stability",
    "Stability: how far an attack must go before the mark breaks",
    "At which strength does each attack take bits, then the claim, and what has it cost the attacker by then?",
    cells,
    report,
    frozenset({"quick", "settings"}),
)
