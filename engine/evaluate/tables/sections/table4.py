"""Table 4: other kinds of Gaussian models."""

from engine.evaluate.study import Bar, Cell, Options, Row, Section, Table
from engine.evaluate.tables.effort import scenes_of
from engine.evaluate.tables.paper import PUBLISHED, printed
from engine.evaluate.tables.part import CELLS, Part
from engine.evaluate.tables.words import range_text

KINDS = ("2dgs", "4dgs", "compact3d", "dreamgaussian")
MOST_DROP_DB = 0.1


def cells(options: Options) -> list[Cell]:
    """Every scene as every kind; none in a quick run, because making one of them takes minutes."""
    return [
        Cell(
            f"table4-{kind}-{short}",
            f"{CELLS}.variants:measure_variants",
            {"scene": path, "kind": kind, "seed": options.seed},
        )
        for short, path in scenes_of(options)
        for kind in (() if options.quick else KINDS)
    ]


def section(rows: list[Row], options: Options) -> Section:
    """Quality before and after, bits over all readings, and each reading."""
    of = _own(rows)
    paper = {row["variant"]: row for row in printed("table4")}
    ours = [
        [
            row["scene"],
            row["variant"],
            row["psnr_before"],
            row["psnr_after"],
            f"{row['psnr_drop']:.3f}",
            row["ms_ssim_distance_before"],
            row["ms_ssim_distance_after"],
            f"{row['all_bits']} of {row['cases']}",
            f"{row['claimed']} of {row['cases']}",
            f"{row['weakest']}: {100 * row['weakest_bits']:.1f} %, z {row['weakest_z']:.0f}",
            paper[row["model"]]["psnr_before"] - paper[row["model"]]["psnr_after"],
            paper[row["model"]]["bit_accuracy"],
        ]
        for row in of
    ]
    columns = (
        "scene",
        "variant",
        "PSNR before, dB",
        "after",
        "drop, dB",
        "1 - MS-SSIM before",
        "after",
        "readings whole",
        "claims at 1e-9",
        "weakest reading",
        "the paper: drop, dB",
        "its bits, %",
    )
    theirs = [
        [
            row["variant"],
            row["psnr_before"],
            row["psnr_after"],
            row["psnr_before"] - row["psnr_after"],
            row["lpips_before"],
            row["lpips_after"],
            row["bit_accuracy"],
        ]
        for row in printed("table4")
    ]
    each = [
        [row["scene"], row["variant"], reading["case"], 100 * reading["bit_accuracy"], reading["z"], reading["verdict"]]
        for row in of
        for reading in row["row"]["readings"]
    ]
    return Section(
        "Table 4: 2DGS, 4DGS, codebooks, generated models",
        [
            "No file of these kinds is at hand: each is made from the scene (discs by flattening and refitting, "
            "motion by swaying and fitting Spacetime Gaussians, a codebook by clustering, a generator's by "
            "training on few pictures) and goes through its own file format before and after the mark. PSNR is "
            "against the scene it was made from; 32 bits; one marking each, so no interval.",
            PUBLISHED,
            *(["Not part of a quick run: making one of these takes minutes."] if options.quick else []),
        ],
        [
            Table(columns, ours, "Ours"),
            Table(
                ("variant", "PSNR before, dB", "after", "drop, dB", "LPIPS before", "after", "bit accuracy, %"),
                theirs,
                "As the paper prints it",
            ),
            Table(("scene", "variant", "reading", "bits, %", "z", "verdict"), each, "Every reading"),
        ],
    )


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """All bits in all readings, and 0.1 dB."""
    made = []
    for row in _own(rows):
        whole, cases = row["all_bits"], row["cases"]
        made.append(
            Bar(
                f"{row['variant']} of {row['scene']}: bits in every reading, claims",
                "100 %, all claimed",
                f"{whole} of {cases} readings whole, {row['claimed']} claimed; weakest {row['weakest']} "
                f"{100 * row['weakest_bits']:.1f} %",
                whole == cases == row["claimed"],
            )
        )
        drop = range_text([row["psnr_drop"]], 3)
        made.append(
            Bar(
                f"{row['variant']} of {row['scene']}: what the mark costs",
                f"<= {MOST_DROP_DB} dB",
                f"{drop} dB",
                row["psnr_drop"] <= MOST_DROP_DB,
            )
        )
    return made


def _own(rows: list[Row]) -> list[Row]:
    return [row for row in rows if "psnr_drop" in row]


PART = Part(
    "table4",
    "Table 4: other kinds of Gaussian models",
    "Can 2DGS, 4DGS, codebook and generated models be marked too?",
    cells,
    section,
    bars,
)
