"""Table 4: other kinds of Gaussian models."""

from engine.lab.evaluate.study import Bar, Cell, Options, Row, Section
from engine.lab.evaluate.summary import table
from engine.lab.evaluate.tables.part import PUBLISHED, Part, printed, printed_table, scenes_of

KINDS = ("2dgs", "4dgs", "compact3d", "dreamgaussian")
MOST_DROP_DB = 0.1


def cells(options: Options) -> list[Cell]:
    """Every scene as every kind; none in a quick run, because making one of them takes minutes."""
    return [
        Cell(
            f"table4-{kind}-{short}",
            "engine.lab.evaluate.bench.marking:measure_variants",
            {"scene": path, "setting": kind, "seed": options.seed},
        )
        for short, path in scenes_of(options)
        for kind in (() if options.quick else KINDS)
    ]


def section(rows: list[Row], options: Options) -> Section:
    """Quality before and after, bits over all readings, and each reading."""
    of = _own(rows)
    paper = {row["variant"]: row for row in printed("table4")}

    def theirs(row: Row) -> Row:
        return next(said for kind, said in paper.items() if str(row["variant"]).lower().startswith(kind))

    ours = table(
        of,
        "scene",
        "variant",
        ("PSNR before, dB", "psnr_before"),
        ("after", "psnr_after"),
        ("drop, dB", "{psnr_drop:.3f}"),
        ("1 - MS-SSIM before", "ms_ssim_distance_before"),
        ("after", "ms_ssim_distance_after"),
        ("readings whole", "{all_bits} of {cases}"),
        ("claims at 1e-9", "{claimed} of {cases}"),
        ("weakest reading", lambda row: "{}: {:.1f} %, z {:.0f}".format(*_weakest(row), row["weakest_z"])),
        ("the paper: drop, dB", lambda row: _drop(theirs(row))),
        ("its bits, %", lambda row: theirs(row)["bit_accuracy"]),
        title="Ours",
    )
    each = table(
        [{**row, **reading} for row in of for reading in row["row"]["readings"]],
        "scene",
        "variant",
        ("reading", "case"),
        ("bits, %", lambda reading: 100 * reading["bit_accuracy"]),
        "z",
        "verdict",
        title="Every reading",
    )
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
            ours,
            printed_table(
                "table4",
                "variant",
                ("PSNR before, dB", "psnr_before"),
                ("after", "psnr_after"),
                ("drop, dB", _drop),
                ("LPIPS before", "lpips_before"),
                ("after", "lpips_after"),
                ("bit accuracy, %", "bit_accuracy"),
            ),
            each,
        ],
    )


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """All bits in all readings, and 0.1 dB."""
    made = []
    for row in _own(rows):
        name, whole, cases = f"{row['variant']} of {row['scene']}", row["all_bits"], row["cases"]
        weakest, drop = "{} {:.1f} %".format(*_weakest(row)), row["psnr_drop"]
        said = f"{whole} of {cases} readings whole, {row['claimed']} claimed; weakest {weakest}"
        made += [
            Bar(f"{name}: bits in every reading, claims", "100 %, all claimed", said, whole == cases == row["claimed"]),
            Bar(f"{name}: what the mark costs", f"<= {MOST_DROP_DB} dB", f"{drop:.3f} dB", drop <= MOST_DROP_DB),
        ]
    return made


def _weakest(row: Row) -> tuple[str, float]:
    return str(row["weakest"]), 100 * float(row["weakest_bits"])


def _drop(row: Row) -> float:
    return float(row["psnr_before"] - row["psnr_after"])


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
