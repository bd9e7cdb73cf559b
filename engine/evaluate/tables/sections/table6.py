"""Table 6: what the losses of the refinement buy, and the paper's two sets of weights."""

from typing import Any

from engine.evaluate.study import Bar, Cell, Options, Row, Section, Table
from engine.evaluate.tables.compare import CONDITIONS, effect
from engine.evaluate.tables.paper import PUBLISHED, printed
from engine.evaluate.tables.part import Part, of_kind, setting_cells
from engine.evaluate.tables.setting import DEFAULT, Setting
from engine.evaluate.tables.words import INTERVALS, accuracy, mean_text

STEPS, QUICK_STEPS = 60, 2
UNMARKED = Setting("unmarked", unmarked=True)
ROWS = {
    "unmarked": "none: the unmarked model",
    "default": "closed form, no refinement (what every profile does)",
    "loss-msg": "msg",
    "loss-msg-rec": "msg + rec",
    "loss-text": "msg + rec + wavelet, weights of the text 0.4, 1.0, 0.3",
    "loss-appendix": "msg + rec + wavelet, weights of the appendix 0.2, 0.5, 0.05",
}
PAPER = {"unmarked": "none", "loss-msg": "msg", "loss-msg-rec": "msg+rec", "loss-text": "msg+rec+wavelet"}
"""Rows of the paper's table that ours stand beside."""


def refined(name: str, msg: float, rec: float, wavelet: float, *, quick: bool = False) -> Setting:
    """A setting with the refinement on and these weights."""
    steps = QUICK_STEPS if quick else STEPS
    return Setting(name, {"refine": {"steps": steps, "lambda_msg": msg, "lambda_rec": rec, "lambda_wavelet": wavelet}})


def settings(quick: bool) -> list[Setting]:
    """The rows of the table that are marked."""
    every = [
        DEFAULT,
        UNMARKED,
        refined("loss-text", 0.4, 1.0, 0.3, quick=quick),
        refined("loss-msg", 0.4, 0.0, 0.0, quick=quick),
        refined("loss-msg-rec", 0.4, 1.0, 0.0, quick=quick),
        refined("loss-appendix", 0.2, 0.5, 0.05, quick=quick),
    ]
    return every[:3] if quick else every


def cells(options: Options) -> list[Cell]:
    """Every row under every key."""
    return setting_cells(options, settings(options.quick))


def section(rows: list[Row], options: Options) -> Section:
    """The paper's rows and ours."""
    ours: list[list[Any]] = []
    paper = {row["losses"]: row for row in printed("table6")}
    for setting, name in ROWS.items():
        of = of_kind(rows, setting=setting)
        pictures, views, marked = (of_kind(of, kind=kind) for kind in ("picture", "view", "marked"))
        if not marked:
            continue
        unseen = setting == "unmarked"
        ours.append(
            [
                name,
                str(accuracy(of_kind(pictures, attack="none"))),
                f"{sum(row['claimed'] for row in pictures + marked)} of {len(pictures + marked)}",
                None if unseen else mean_text([row["psnr"] for row in views]),
                mean_text([row["ssim"] for row in views], 4),
                mean_text([row["distance"] for row in views], 5),
                *(None if unseen else str(effect(rows, setting, "default", c) or "") for c in ("model", *CONDITIONS)),
                f"{sum(row['refine_seconds'] for row in marked) / len(marked):.1f}",
                *(paper.get(PAPER.get(setting, ""), {}).get(name) for name in ("bit_accuracy", "psnr")),
            ]
        )
    columns = (
        "losses",
        "bits, one picture",
        "claims at 1e-9",
        "PSNR, dB",
        "SSIM",
        "1 - MS-SSIM",
        "z of the model",
        *(f"z, {'no attack' if c == 'none' else c}" for c in CONDITIONS),
        "refinement, s",
        "the paper: bits, %",
        "its PSNR, dB",
    )
    theirs = [[*row.values()] for row in printed("table6")]
    return Section(
        "Table 6: losses of the refinement",
        [
            f"{STEPS if not options.quick else QUICK_STEPS} Adam steps on the colours. After them the strength is "
            "solved again, so all rows have the same fidelity in the worst key view, and what a loss buys or "
            "costs shows in z, given as the change against the closed form (paired by scene, key and view; "
            "bootstrap interval over pairs).",
            "The unmarked model has no message to read: its bits are coin tosses under the record's weights, and "
            "it is never claimed.",
            INTERVALS,
            PUBLISHED,
        ],
        [
            Table(columns, ours, "Ours"),
            Table(("losses", "bit accuracy, %", "PSNR, dB", "SSIM", "LPIPS"), theirs, "As the paper prints it"),
        ],
    )


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """No claim on the unmarked model."""
    of = [row for row in of_kind(rows, setting="unmarked") if "claimed" in row]
    if not of:
        return []
    claims = sum(row["claimed"] for row in of)
    largest = max(row["z"] for row in of)
    return [Bar("unmarked model, claims", "0", f"{claims} of {len(of)} readings, largest z {largest:.2f}", claims == 0)]


PART = Part(
    "table6",
    "Table 6: losses of the refinement",
    "What do the three losses of Eq 9 buy over the closed-form mark?",
    cells,
    section,
    bars,
)
