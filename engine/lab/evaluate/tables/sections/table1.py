"""Table 1: bit accuracy and fidelity at every message length."""

from statistics import fmean

from engine.lab.evaluate.figures import Figure, figure, styles
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Row, Section, Table
from engine.lab.evaluate.summary import INTERVALS, accuracy, grouped, mean_text, table
from engine.lab.evaluate.tables.part import (
    FIDELITY,
    PUBLISHED,
    Part,
    Setting,
    printed,
    printed_table,
    rows_of_setting,
    setting_cells,
    system,
)

LENGTHS = (16, 32, 48, 64, 128, 256)
LEAST_DB, LEAST_SSIM = 47.0, 0.998


def cells(options: Options) -> list[Cell]:
    """Every length under every key."""
    lengths = LENGTHS[1:2] if options.quick else LENGTHS
    return setting_cells(options, [Setting(_name(bits), bits=bits) for bits in lengths], sweep=False)


def section(rows: list[Row], options: Options) -> Section:
    """The paper's columns and ours."""
    lengths = _lengths(rows)
    ours = table(
        [of for of in lengths if of["marked"]],
        "bits",
        ("accuracy, one picture", lambda of: str(accuracy(of["picture"]))),
        ("accuracy, model", lambda of: str(accuracy(of["marked"]))),
        *FIDELITY,
        ("worst key view, dB", lambda of: _least(of, "psnr_worst_view")),
        ("its SSIM", lambda of: f"{_least(of, 'ssim_worst_view'):.4f}"),
        ("z of a picture", lambda of: mean_text([row["z"] for row in of["picture"]])),
        ("capacity, bits", lambda of: min(row["capacity_bits"] for row in of["marked"])),
        title="Ours in full",
    )
    best = [accuracy(of["picture"]) for of in lengths]
    wide = [["ours", *(None if found is None else f"{100 * found.share:.2f}" for found in best)]]
    for name, lines in _published().items():
        bits_of = {row["bits"]: row["bit_accuracy"] for row in lines}
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
            *(f"{row['scene']}: {row['reason']}" for of in lengths for row in of["refused"]),
        ],
        [
            Table(("system", *map(str, LENGTHS)), wide, "Bit accuracy by message length, %"),
            ours,
            printed_table(
                "table1",
                "system",
                "bits",
                ("bit accuracy, %", "bit_accuracy"),
                ("PSNR, dB", "psnr"),
                ("LPIPS", "lpips"),
            ),
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
    for of in _lengths(rows):
        found, refused = accuracy(of["picture"] + of["marked"]), of["refused"]
        said = f"{found}" if found else "not run"
        if refused:
            said += f"; refused on {', '.join(sorted({row['scene'] for row in refused}))}"
        met = None if found is None and not refused else bool(found and found.share == 1.0 and not refused)
        made.append(Bar(f"{of['bits']} bits, no attack (pictures and models)", "100 %", said, met))
        if of["bits"] == 32 and of["marked"]:
            psnr, ssim = _least(of, "psnr_worst_view"), _least(of, "ssim_worst_view")
            fidelity = Bar(
                "fidelity of the mark, 32 bits, worst key view",
                f">= {LEAST_DB:g} dB, SSIM >= {LEAST_SSIM}",
                f"{psnr:.2f} dB, SSIM {ssim:.4f}, lowest of {len(of['marked'])} markings",
                psnr >= LEAST_DB and ssim >= LEAST_SSIM,
            )
            made.append(fidelity)
    return made


def draw(rows: list[Row]) -> Figure:
    """Accuracy and PSNR against the length."""
    drawn, (left, right) = figure(1, 2, width=8.6, height=3.6, sharex=True)
    style = styles()
    mine = next(style) | {"linewidth": 2.4, "markersize": 6.5}
    for name, lines in _published().items():
        look = next(style) | {"linewidth": 1.2, "markersize": 4.5}
        lengths = [row["bits"] for row in lines]
        left.plot(lengths, [row["bit_accuracy"] for row in lines], label=name, **look)
        right.plot(lengths, [row["psnr"] for row in lines], label=name, **look)
    points = [
        (of["bits"], found, fmean(row["psnr"] for row in of["view"]))
        for of in _lengths(rows)
        if (found := accuracy(of["picture"])) is not None
    ]
    whole = bool(points) and all(found.share == 1.0 for _, found, _ in points)
    if points:
        bits, found_, levels = zip(*points, strict=True)
        errors = list(zip(*(found.error for found in found_), strict=True))
        shares = [100 * found.share for found in found_]
        left.errorbar(bits, shares, yerr=errors, label="ours (informed)", capsize=2, zorder=5, **mine)
        right.plot(bits, levels, label="ours (informed)", zorder=5, **mine)
    left.set_title(f"Ours: every bit read, up to {points[-1][0]}" if whole else "Bits by message length")
    right.set_title(f"Ours: {min(levels):.1f} to {max(levels):.1f} dB" if points else "Fidelity")
    for axes, label in ((left, "bit accuracy, %"), (right, "PSNR, dB")):
        axes.set_xscale("log", base=2)
        axes.set_xticks(LENGTHS, [str(bits) for bits in LENGTHS])
        axes.minorticks_off()
        axes.set(xlabel="message, bits", ylabel=label)
    drawn.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return drawn


def _name(bits: int) -> str:
    return f"bits-{bits}"


def _lengths(rows: list[Row]) -> list[Row]:
    return [{"bits": bits, **rows_of_setting(rows, _name(bits))} for bits in LENGTHS]


def _least(of: Row, name: str) -> float:
    return float(min(row[name] for row in of["marked"]))


def _published() -> dict[str, list[Row]]:
    return grouped([{**row, "system": system(row)} for row in printed("table1")], "system")


PART = Part(
    "table1",
    "Table 1: bit accuracy and fidelity",
    "Are all bits read, at which length, and what does it cost the look?",
    cells,
    section,
    bars,
)
