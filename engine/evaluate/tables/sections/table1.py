"""Table 1: bit accuracy and fidelity at every message length."""

from __future__ import annotations

from typing import TYPE_CHECKING

from engine.evaluate.drawing import figure, styles
from engine.evaluate.study import Bar, Cell, Drawing, Options, Row, Section, Table
from engine.evaluate.tables.paper import PUBLISHED, printed
from engine.evaluate.tables.part import Part, of_kind, setting_cells
from engine.evaluate.tables.setting import Setting
from engine.evaluate.tables.words import INTERVALS, accuracy, mean_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LENGTHS = (16, 32, 48, 64, 128, 256)
LEAST_DB, LEAST_SSIM = 47.0, 0.998


def cells(options: Options) -> list[Cell]:
    """Every length under every key."""
    lengths = LENGTHS[1:2] if options.quick else LENGTHS
    return setting_cells(options, [Setting(_name(bits), bits=bits) for bits in lengths], sweep=False)


def section(rows: list[Row], options: Options) -> Section:
    """The paper's columns and ours."""
    ours = []
    for bits in LENGTHS:
        of = of_kind(rows, setting=_name(bits))
        marked, views = of_kind(of, kind="marked"), of_kind(of, kind="view")
        if not marked:
            continue
        ours.append(
            [
                bits,
                str(accuracy(of_kind(of, kind="picture"))),
                str(accuracy(marked)),
                mean_text([row["psnr"] for row in views]),
                mean_text([row["ssim"] for row in views], 4),
                mean_text([row["distance"] for row in views], 5),
                min(row["psnr_worst_view"] for row in marked),
                f"{min(row['ssim_worst_view'] for row in marked):.4f}",
                _z(of),
                min(row["capacity_bits"] for row in marked),
            ]
        )
    refused = of_kind(rows, kind="refused")
    columns = (
        "bits",
        "accuracy, one picture",
        "accuracy, model",
        "PSNR, dB",
        "SSIM",
        "1 - MS-SSIM",
        "worst key view, dB",
        "its SSIM",
        "z of a picture",
        "capacity, bits",
    )
    table = printed("table1")
    theirs = [[row["system"], row["bits"], row["bit_accuracy"], row["psnr"], row["lpips"]] for row in table]
    best = {bits: accuracy(of_kind(rows, setting=_name(bits), kind="picture")) for bits in LENGTHS}
    wide = [["ours", *(None if a is None else f"{100 * a.share:.2f}" for a in best.values())]]
    for system in dict.fromkeys(row["system"] for row in table):
        bits_of = {row["bits"]: row["bit_accuracy"] for row in of_kind(table, system=system)}
        name = "the paper" if system == "Mark3DGS" else system
        wide.append([f"{name} (published)", *(bits_of.get(bits) for bits in LENGTHS)])
    return Section(
        "Table 1: bits and fidelity by message length",
        [
            "Ours: one picture a reading, its camera known, from views that are not the key views. PSNR, SSIM "
            "and 1 - MS-SSIM (a stand-in for LPIPS, whose weights are not at hand; not comparable with it) are "
            "means over these views against the unmarked render, with a bootstrap interval over views; 'worst "
            "key view' is what the embedding guarantees.",
            INTERVALS,
            PUBLISHED + " Its PSNR mixes two references (photographs and renders).",
            *(f"{row['scene']}: {row['reason']}" for row in refused if row["setting"] in map(_name, LENGTHS)),
        ],
        [
            Table(("system", *map(str, LENGTHS)), wide, "Bit accuracy by message length, %"),
            Table(columns, ours, "Ours in full"),
            Table(("system", "bits", "bit accuracy, %", "PSNR, dB", "LPIPS"), theirs, "As the paper prints it"),
        ],
        [
            Drawing(
                "table1",
                lambda: draw(rows),
                "Bit accuracy and PSNR by message length. Ours: informed, one picture a reading, error bars "
                "exact 95 % over all bits. Others: published, other hardware and scenes, blind.",
            )
        ],
    )


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """All bits at all lengths; fidelity at 32."""
    made = []
    for bits in LENGTHS:
        of = of_kind(rows, setting=_name(bits))
        found = accuracy([row for row in of if row["kind"] in ("picture", "marked")])
        refused = of_kind(of, kind="refused")
        said = f"{found}" if found else "not run"
        if refused:
            said += f"; refused on {', '.join(sorted({row['scene'] for row in refused}))}"
        met = None if found is None and not refused else bool(found and found.share == 1.0 and not refused)
        made.append(Bar(f"{bits} bits, no attack (pictures and models)", "100 %", said, met))
    marked = of_kind(rows, setting=_name(32), kind="marked")
    if marked:
        psnr, ssim = (min(row[name] for row in marked) for name in ("psnr_worst_view", "ssim_worst_view"))
        made.append(
            Bar(
                "fidelity of the mark, 32 bits, worst key view",
                f">= {LEAST_DB:g} dB, SSIM >= {LEAST_SSIM}",
                f"{psnr:.2f} dB, SSIM {ssim:.4f}, lowest of {len(marked)} markings",
                psnr >= LEAST_DB and ssim >= LEAST_SSIM,
            )
        )
    return made


def draw(rows: list[Row]) -> Figure:
    """Accuracy and PSNR against the length."""
    drawn, (left, right) = figure(1, 2, width=8.6, height=3.6, sharex=True)
    named: dict[str, list[Row]] = {}
    for row in printed("table1"):
        named.setdefault(row["system"], []).append(row)
    style = styles()
    mine = next(style) | {"linewidth": 2.4, "markersize": 6.5}
    points = []
    for bits in LENGTHS:
        of = of_kind(rows, setting=_name(bits))
        found = accuracy(of_kind(of, kind="picture"))
        if found is not None:
            views = of_kind(of, kind="view")
            points.append((bits, found, sum(row["psnr"] for row in views) / len(views)))
    for system, printed_rows in named.items():
        look = next(style) | {"linewidth": 1.2, "markersize": 4.5}
        lengths = [row["bits"] for row in printed_rows]
        name = "the paper" if system == "Mark3DGS" else system
        left.plot(lengths, [row["bit_accuracy"] for row in printed_rows], label=name, **look)
        right.plot(lengths, [row["psnr"] for row in printed_rows], label=name, **look)
    if points:
        bits_, found_, psnr_ = zip(*points, strict=True)
        errors = [[100 * (a.share - a.low) for a in found_], [100 * (a.high - a.share) for a in found_]]
        share = [100 * a.share for a in found_]
        left.errorbar(bits_, share, yerr=errors, label="ours (informed)", capsize=2, zorder=5, **mine)
        right.plot(bits_, psnr_, label="ours (informed)", zorder=5, **mine)
    for axes, label in ((left, "bit accuracy, %"), (right, "PSNR, dB")):
        axes.set_xscale("log", base=2)
        axes.set_xticks(LENGTHS, [str(bits) for bits in LENGTHS])
        axes.minorticks_off()
        axes.set_xlabel("message, bits")
        axes.set_ylabel(label)
    whole = bool(points) and all(found.share == 1.0 for _, found, _ in points)
    left.set_title(f"Ours: every bit read, up to {points[-1][0]}" if whole else "Bits by message length")
    levels = [psnr for *_, psnr in points]
    right.set_title(f"Ours: {min(levels):.1f} to {max(levels):.1f} dB" if levels else "Fidelity")
    drawn.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return drawn


def _name(bits: int) -> str:
    return f"bits-{bits}"


def _z(rows: list[Row]) -> str:
    return mean_text([row["z"] for row in of_kind(rows, kind="picture")])


PART = Part(
    "table1",
    "Table 1: bit accuracy and fidelity",
    "Are all bits read, at which length, and what does it cost the look?",
    cells,
    section,
    bars,
)
