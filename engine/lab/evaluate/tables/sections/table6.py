"""Table 6: what the losses of the refinement buy, and the paper's two sets of weights."""

from statistics import fmean

from engine.lab.evaluate.study import Bar, Cell, Options, Row, Section
from engine.lab.evaluate.summary import INTERVALS, Column, accuracy, picked, table
from engine.lab.evaluate.tables.part import (
    CONDITIONS,
    DEFAULT,
    FIDELITY,
    PUBLISHED,
    Part,
    Setting,
    printed,
    printed_table,
    rows_of_setting,
    setting_cells,
)
from engine.lab.evaluate.tables.tables_curves import effect

STEPS, QUICK_STEPS = 100, 2
"""The paper runs 10,000; what more of them change is measured once, by the part `paper`."""
UNMARKED = Setting("unmarked", unmarked=True)
ROWS = {
    "unmarked": "none: the unmarked model",
    "default": "closed form, no refinement (what every profile does)",
    "loss-msg": "msg",
    "loss-msg-rec": "msg + rec",
    "loss-text": "msg + rec + wavelet, weights of the text 0.4, 1.0, 0.3",
    "loss-appendix": "msg + rec + wavelet, weights of the appendix 0.2, 0.5, 0.05",
}
LOSSES = {
    "loss-text": (0.4, 1.0, 0.3),
    "loss-msg": (0.4, 0.0, 0.0),
    "loss-msg-rec": (0.4, 1.0, 0.0),
    "loss-appendix": (0.2, 0.5, 0.05),
}
"""Weights of the message, the pictures and their wavelets."""
PAPER = {"unmarked": "none", "loss-msg": "msg", "loss-msg-rec": "msg+rec", "loss-text": "msg+rec+wavelet"}
"""Rows of the paper's table that are compared with ours."""


def refined(name: str, msg: float, rec: float, wavelet: float, *, quick: bool = False) -> Setting:
    """A setting with the refinement on and these weights."""
    steps = QUICK_STEPS if quick else STEPS
    return Setting(name, {"refine": {"steps": steps, "lambda_msg": msg, "lambda_rec": rec, "lambda_wavelet": wavelet}})


def settings(quick: bool) -> list[Setting]:
    """The rows of the table that are marked."""
    every = [DEFAULT, UNMARKED, *(refined(name, *weights, quick=quick) for name, weights in LOSSES.items())]
    return every[:3] if quick else every


def cells(options: Options) -> list[Cell]:
    """Every row under every key."""
    return setting_cells(options, settings(options.quick))


def section(rows: list[Row], options: Options) -> Section:
    """The paper's rows and ours."""
    lines = [{"setting": name, **rows_of_setting(rows, name)} for name in ROWS]
    paper = {row["losses"]: row for row in printed("table6")}

    def change(condition: str) -> Column:
        seen = {"model": "z of the model", "none": "z, no attack"}.get(condition, f"z, {condition}")
        return (seen, lambda of: None if of["setting"] == UNMARKED.name else _change(rows, of["setting"], condition))

    def claims(of: Row) -> str:
        read = of["picture"] + of["marked"]
        return f"{sum(row['claimed'] for row in read)} of {len(read)}"

    ours = table(
        [of for of in lines if of["marked"]],
        ("losses", lambda of: ROWS[of["setting"]]),
        ("bits, one picture", lambda of: str(accuracy(picked(of["picture"], attack="none")))),
        ("claims at 1e-9", claims),
        *FIDELITY,
        *(change(condition) for condition in ("model", *CONDITIONS)),
        ("refinement, s", lambda of: f"{fmean(row['refine_seconds'] for row in of['marked']):.1f}"),
        ("the paper: bits, %", lambda of: paper.get(PAPER.get(of["setting"], ""), {}).get("bit_accuracy")),
        ("its PSNR, dB", lambda of: paper.get(PAPER.get(of["setting"], ""), {}).get("psnr")),
        title="Ours",
    )
    theirs = printed_table(
        "table6",
        "losses",
        ("bit accuracy, %", "bit_accuracy"),
        ("PSNR, dB", "psnr"),
        ("SSIM", "ssim"),
        ("LPIPS", "lpips"),
    )
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
        [ours, theirs],
    )


def _change(rows: list[Row], setting: str, condition: str) -> str:
    return str(effect(rows, setting, "default", condition) or "")


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """No claim on the unmarked model."""
    of = [row for row in picked(rows, setting=UNMARKED.name) if "claimed" in row]
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
