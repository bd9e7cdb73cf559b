"""What all sweeps, odd inputs and repeats say together."""

import math
from collections.abc import Sequence
from functools import partial

from engine.evaluate.intervals import share_interval
from engine.evaluate.stability.breaking import Break
from engine.evaluate.stability.figures import draw_costs, draw_map
from engine.evaluate.stability.summing import Swept, failing_first, sum_up
from engine.evaluate.study import Bar, Drawing, Options, Report, Row, Section, Table
from engine.sim.cost import CHEAP_DB

__all__ = ["report"]


def report(rows: list[Row], options: Options) -> Report:
    """Misses first: attacks that take the claim and keep the look, odd inputs at fault, answers that differ."""
    swept = failing_first(sum_up(rows))
    odd = [row for row in rows if row["what"] == "stress"]
    same = [row for row in rows if row["what"] == "same"]
    refused = [row for row in rows if row["what"] == "sweep" and "refused" in row]
    sections = [_section(swept, kind, refused) for kind in ("model", "image")]
    sections += [_odd_section(odd), _same_section(same)]
    bars = [*_attack_bars(swept), *_input_bars(odd), *_same_bars(same)]
    return Report(
        bars,
        sections,
        answer=_answer(swept),
        summary={
            "sweeps": len(swept),
            "claims_lost": [one.name for one in swept if one.claim_break.lost],
            "bits_lost": [one.name for one in swept if one.bits_break.lost],
            "claims_lost_cheaply": [one.name for one in swept if one.is_cheap],
        },
    )


def _answer(swept: Sequence[Swept]) -> list[str]:
    told = []
    for kind, what in (("model", "models"), ("image", f"a single picture of {400} pixels")):
        own = [one for one in swept if one.kind == kind]
        lost = [one for one in own if one.claim_break.lost]
        cheap = [one for one in own if one.is_cheap]
        told.append(
            f"Of {len(own)} sweeps on {what}, {len(own) - len(lost)} never take the claim at 1e-9; {len(lost)} do "
            f"at some strength, {len(cheap)} of them before the attacker has paid with the look "
            f"({CHEAP_DB:g} dB){': ' + ', '.join(one.name for one in cheap) if cheap else ''}."
        )
    return told


def _attack_bars(swept: Sequence[Swept]) -> list[Bar]:
    bars = []
    for kind, what in (("model", "models"), ("image", "one picture")):
        own = [one for one in swept if one.kind == kind]
        cheap = [one for one in own if one.is_cheap]
        low, high = share_interval(len(cheap), len(own))
        names = "".join(f"; {one.name}" for one in cheap)
        bars.append(
            Bar(
                f"sweeps on {what} that take the claim and keep {CHEAP_DB:g} dB",
                "none",
                f"{len(cheap)} of {len(own)} (95 % of the like: {100 * low:.0f} to {100 * high:.0f} %){names}",
                not cheap if own else None,
            )
        )
    return bars


def _input_bars(odd: Sequence[Row]) -> list[Bar]:
    faults = [row for row in odd if row["outcome"] == "fault"]
    same = sum(row["outcome"] == "same" for row in odd)
    words = "".join(f"; {row['input']} ({row['role']}): {row['words']}" for row in faults)
    measured = f"{len(faults)} of {len(odd)} at fault; {same} answer alike, {len(odd) - same - len(faults)} refused"
    return [Bar("odd inputs: the same claim each time or a plain refusal", "0 faults", measured + words, not faults)]


def _same_bars(same: Sequence[Row]) -> list[Bar]:
    bytewise = [row for row in same if not row["how"].startswith(("every number", "seed", "processor"))]
    differ = [row for row in bytewise if not row["exact"]]
    apart = [row for row in same if not row["close"]]
    listed = "".join(f"; {row['how']}" for row in differ)
    return [
        Bar(
            "again, from float64, by other numbers of threads: the same bytes of the claim",
            "all",
            f"{len(bytewise) - len(differ)} of {len(bytewise)}{listed}",
            not differ,
        ),
        Bar(
            "seeds, rounding, processors: the same verdict and bits, z within 0.1 %",
            "all",
            f"{len(same) - len(apart)} of {len(same)}" + "".join(f"; {row['how']}" for row in apart),
            not apart,
        ),
    ]


def _section(swept: Sequence[Swept], kind: str, refused: Sequence[Row]) -> Section:
    own = [one for one in swept if one.kind == kind]
    what = "models" if kind == "model" else "one picture"
    missing = sorted({f"{row['attack']}: {row['refused']}" for row in refused if row["kind"] == kind})
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
    title = f"{len(own) - lost} of {len(own)} attacks on {what} never take the claim"
    drawings = [
        Drawing(
            f"map-{kind}",
            partial(draw_map, own, kind, title),
            f"Attacks on {what}, failing first, each from its harmless to its ruinous strength. Dark is lost; white "
            "was not measured.",
        ),
        Drawing(
            f"cost-{kind}",
            partial(draw_costs, swept, kind),
            f"Attacks on {what} that come nearest to taking the claim: z against the look that is left.",
        ),
    ]
    return Section(f"Attacks on {what}", text, [_break_table(own)], drawings if own else ())


def _break_table(swept: Sequence[Swept]) -> Table:
    lines = []
    for one in swept:
        bits, claim = one.bits_break, one.claim_break
        last = len(one.strengths) - 1
        low, high = one.z_interval(last)
        share_low, share_high = one.claims_interval(last)
        at = claim.step if claim.lost else last
        look, left = one.psnr_at(at), one.coverage_at(at)
        looking = "; ".join(f"z {z:.1f} at {strength}" for strength, z in one.by_looking.items())
        lines.append(
            [
                one.name,
                _where(one, bits),
                _where(one, claim),
                None if look is None else f"{look:.1f}{' (end)' if not claim.lost else ''}",
                None if left is None else f"{100 * left:.0f} %",
                f"{one.strengths[-1]}",
                f"{100 * one.bits[:, -1].mean():.1f} %",
                f"{one.z[:, -1].mean():.1f} ({low:.1f} to {high:.1f})",
                f"{int(one.claimed[:, -1].sum())} of {len(one.claimed)} "
                f"({100 * share_low:.0f} to {100 * share_high:.0f} %)",
                looking,
            ]
        )
    return Table(
        [
            "attack",
            "bits below 99 % at",
            "claim lost at",
            "PSNR by then, dB",
            "covered by then",
            "grid ends at",
            "bits there",
            "z there (95 %)",
            "claims there (95 %)",
            "by looking",
        ],
        lines,
        "Failing first",
    )


def _where(one: Swept, broken: Break) -> str:
    if not broken.lost:
        return "never"
    if not one.ordered:
        return str(one.strength_of(broken.step))
    low, high = one.strength_of(broken.low), one.strength_of(broken.high)
    if broken.step == 0.0:
        return f"{one.strengths[0]} (the mildest)"
    upper = "the end" if not math.isfinite(broken.high) else f"{high:.3g}"
    before = one.strengths[math.ceil(broken.step) - 1]
    after = one.strengths[math.ceil(broken.step)]
    return f"{one.strength_of(broken.step):.3g} (between {before} and {after}; trials: {low:.3g} to {upper})"


def _odd_section(odd: Sequence[Row]) -> Section:
    lines = [
        [
            row["input"],
            row["role"],
            {"same": "answers", "refused": "refused", "fault": "FAULT"}[row["outcome"]],
            row.get("verdict"),
            row.get("z"),
            row.get("unmarked_verdict"),
            row.get("words"),
        ]
        for row in sorted(odd, key=lambda row: row["outcome"] != "fault")
    ]
    text = (
        "Each odd input was made of a connected fifth of the scene, written to a PLY, read back (readers repair what "
        "is harmless), marked, opened and verified twice (role marked); and made of a marked model and verified "
        "against its sound record (role suspect). A RuntimeWarning counts as a fault, and so does an own mark not "
        "found or an unmarked model claimed."
    )
    table = Table(["input", "role", "what happened", "verdict", "z", "without its mark", "words"], lines)
    return Section("Odd inputs", [text], [table])


def _same_section(same: Sequence[Row]) -> Section:
    lines = [
        [
            row["how"],
            "yes" if row["exact"] else "no",
            "yes" if row["close"] else "no",
            row["z_model"],
            row.get("z_image"),
            row["model_digest"],
            row.get("image_digest"),
            row.get("marked_digest"),
        ]
        for row in same
    ]
    text = (
        "A suspect cut to half, moved, shuffled and noised is verified again and again; children mark anew as well. "
        "Only this machine was at hand: another processor is played by compiling without AVX."
    )
    columns = [
        "how",
        "same bytes",
        "same answer",
        "z of the model",
        "z of a picture",
        "claim, model",
        "claim, picture",
        "marked model",
    ]
    return Section("The same answer each time", [text], [Table(columns, lines)])
