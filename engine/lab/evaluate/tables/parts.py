"""Tables 1 to 6 and Figure 6 of the paper: the cells that each needs, and the bars that its rows are held to."""

from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.marked_scene import Changes
from engine.lab.evaluate.study import Bar, Cell, Options, Row
from engine.lab.evaluate.summary import Accuracy, accuracy, picked
from engine.lab.evaluate.tables import stopping
from engine.lab.evaluate.tables.part import (
    DEFAULT,
    MEASURING,
    PROFILE,
    Part,
    Setting,
    changes_of,
    efforts,
    rows_of_setting,
    scenes_of,
    setting_cells,
)

# --- Table 1: message lengths --------------------------------------------------------------------------------

LENGTHS = (16, 32, 48, 64, 128, 256)
LEAST_DB, LEAST_SSIM = 47.0, 0.998


def _lengths(options: Options) -> list[Cell]:
    lengths = LENGTHS[1:2] if options.quick else LENGTHS
    return setting_cells(options, [Setting(f"bits-{bits}", bits=bits) for bits in lengths], sweep=False)


def _length_bars(rows: list[Row], options: Options) -> list[Bar]:
    """All bits at all lengths; fidelity at 32."""
    made = []
    for bits in LENGTHS:
        of = rows_of_setting(rows, f"bits-{bits}")
        found, refused = accuracy(of["picture"] + of["marked"]), of["refused"]
        said = f"{found}" if found else "not run"
        if refused:
            said += f"; refused on {', '.join(sorted({row['scene'] for row in refused}))}"
        met = None if found is None and not refused else bool(found and found.share == 1.0 and not refused)
        made.append(Bar(f"{bits} bits, no attack (pictures and models)", "100 %", said, met))
        if bits == 32 and of["marked"]:
            psnr, ssim = (min(row[f"{name}_worst_view"] for row in of["marked"]) for name in ("psnr", "ssim"))
            said = f"{psnr:.2f} dB, SSIM {ssim:.4f}, lowest of {len(of['marked'])} markings"
            wanted, met = f">= {LEAST_DB:g} dB, SSIM >= {LEAST_SSIM}", bool(psnr >= LEAST_DB and ssim >= LEAST_SSIM)
            made.append(Bar("fidelity of the mark, 32 bits, worst key view", wanted, said, met))
    return made


# --- Table 2: attacks ----------------------------------------------------------------------------------------

COLUMNS = {
    "none": "no attack",
    "rotation": "rotation 30 deg",
    "scaling": "scale 0.75",
    "crop": "crop 40 %",
    "jpeg": "JPEG 10",
    "noise": "noise 0.1",
    "clone": "clone 50 %",
    "prune": "prune 20 %",
}
CUTS = ("10 % left, random", "10 % left, one piece")
QUICK_COLUMNS = ("none", "jpeg", "crop", "clone")


def _attacks(options: Options) -> list[Cell]:
    """Pictures and models of every scene under every key."""
    effort, _ = efforts(options)
    columns = list(QUICK_COLUMNS if options.quick else (*COLUMNS, *CUTS))
    made = []
    for short, path in scenes_of(options):
        for seed in range(options.seed, options.seed + effort.keys):
            on = {"scene": path, "seed": seed, "changes": changes_of(options), "columns": columns}
            seen = {**on, "views": effort.views, "size": effort.size}
            made.append(Cell(f"table2-pictures-{short}-k{seed}", f"{MEASURING}:attack_pictures", seen))
            made.append(Cell(f"table2-models-{short}-k{seed}", f"{MEASURING}:attack_models", on))
    return made


def attack_bars(rows: list[Row], options: Options) -> list[Bar]:
    """DESIGN 12: pictures 99.9 %, models 100 %, a tenth of the model 99.9 %."""
    wanted = [("picture", column, 0.999) for column in ("rotation", "scaling", "crop", "jpeg", "noise")]
    wanted += [("model", column, 1.0) for column in ("clone", "prune", "noise")]
    wanted += [("model", column, 0.999) for column in CUTS]
    made = []
    for on, column, least in wanted:
        for reading, words in (("literal", ""), ("as_code", ", as public code runs it")):
            found: Accuracy | None = accuracy(picked(rows, on=on, reading=reading, attack=column))
            if found is not None:
                what = f"32 bits, {on}, {COLUMNS.get(column, column)}{words}"
                bar = "100 %" if least == 1.0 else f">= {100 * least:g} %"
                made.append(Bar(what, bar, str(found), found.share >= least))
    return made


# --- Table 3: time and size ----------------------------------------------------------------------------------

LARGE = 400_000
"""Gaussians from which a scene counts for the bars, which are meant for 500k."""
EMBED_BARS, VERIFY_BAR, BYTES_BAR = {"fast": 15.0, "balanced": 45.0}, 3.0, 20.0


def _costs(options: Options) -> list[Cell]:
    """Two profiles of every scene."""
    changes = {**changes_of(options), "landmark_views": 2} if options.quick else {}
    shared = {"repeats": 1 if options.quick else 3, "width": 1297, "height": 840, "changes": changes}
    return [
        Cell(
            f"table3-{profile}-{short}",
            f"{MEASURING}:measure_costs",
            {"scene": path, "profile": profile, "seed": options.seed, **shared},
        )
        for short, path in scenes_of(options)
        for profile in (("fast",) if options.quick else ("fast", "balanced"))
    ]


def _cost_bars(rows: list[Row], options: Options) -> list[Bar]:
    """Time on large scenes, bytes on all."""
    of = [row for row in rows if "fps_after" in row]
    if not of:
        return []
    made = [
        _timed(of, "embed", f"embed 500k Gaussians, {profile}", most, profile)
        for profile, most in EMBED_BARS.items()
        if picked(of, profile=profile)
    ]
    made.append(_timed(of, "verify", "verify a model of 500k Gaussians", VERIFY_BAR, "fast"))
    for row in picked(of, profile="fast"):
        what, size = f"file of {row['scene']}, compact, .sog", row["compact_sog_bytes"] / row["gaussians"]
        made.append(Bar(what, f"<= {BYTES_BAR:g} bytes a Gaussian", f"{size:.1f}", bool(size <= BYTES_BAR)))
    return made


def _timed(rows: list[Row], what: str, name: str, most: float, profile: str) -> Bar:
    large = [row for row in rows if row["profile"] == profile and row["gaussians"] >= LARGE]
    if not large:
        biggest = max(row["gaussians"] for row in rows)
        said = f"no scene of {LARGE:,} Gaussians or more in this run; largest {biggest:,}"
        return Bar(name, f"<= {most:g} s on 2 cores", said, None)
    slowest = max(large, key=lambda row: float(row[what]))
    said = f"{slowest[what]:.1f} s ({slowest['scene']}, {slowest['gaussians']:,} Gaussians; this machine)"
    return Bar(name, f"<= {most:g} s on 2 cores", said, bool(slowest[what] <= most))


# --- Table 4: other kinds of models --------------------------------------------------------------------------

KINDS = ("2dgs", "4dgs", "compact3d", "dreamgaussian")
MOST_DROP_DB = 0.1


def _kinds(options: Options) -> list[Cell]:
    """Every scene as every kind; none in a quick run, because making one of them takes minutes."""
    work = "engine.lab.evaluate.bench.marking:measure_variants"
    return [
        Cell(f"table4-{kind}-{short}", work, {"scene": path, "setting": kind, "seed": options.seed})
        for short, path in scenes_of(options)
        for kind in (() if options.quick else KINDS)
    ]


def _kind_bars(rows: list[Row], options: Options) -> list[Bar]:
    """All bits in all readings, and 0.1 dB."""
    made = []
    for row in [row for row in rows if "psnr_drop" in row]:
        name, drop = f"{row['variant']} of {row['scene']}", row["psnr_drop"]
        whole, cases = row["all_bits"], row["cases"]
        weakest = f"{row['weakest']} {100 * row['weakest_bits']:.1f} %"
        said = f"{whole} of {cases} readings whole, {row['claimed']} claimed; weakest {weakest}"
        made += [
            Bar(f"{name}: bits in every reading, claims", "100 %, all claimed", said, whole == cases == row["claimed"]),
            Bar(f"{name}: what the mark costs", f"<= {MOST_DROP_DB} dB", f"{drop:.3f} dB", drop <= MOST_DROP_DB),
        ]
    return made


# --- Table 5: fine-tuning ------------------------------------------------------------------------------------

SETTINGS = {
    "key": "marked pictures, key poses",
    "neither": "marked pictures, own poses",
    "clean+key": "clean pictures, key poses",
    "clean": "clean pictures, own poses",
}
BITS, LEAST, EPOCHS = 32, 0.999, 500
SIZE = 400
"""Side of the pictures the attacker trains on, pixels."""


def _trainings(options: Options) -> list[Cell]:
    """One training for each setting and scene."""
    return [
        Cell(
            f"table5-{setting.replace('+', '-and-')}-{short}",
            *training(path, setting, options, PROFILE, changes_of(options)),
        )
        for short, path in scenes_of(options)
        for setting in (("clean+key",) if options.quick else SETTINGS)
    ]


def training(
    path: str, setting: str, options: Options, profile: str, changes: Changes
) -> tuple[str, dict[str, str | int | Changes]]:
    """Function and arguments of a cell: one training of a scene marked by a profile with these changes."""
    epochs, size = (2, 200) if options.quick else (EPOCHS, SIZE)
    shared: dict[str, str | int | Changes] = {"seed": options.seed, "epochs": epochs, "size": size, "changes": changes}
    work = "engine.lab.evaluate.bench.training:measure_fine_tuning"
    return work, {"scene": path, "setting": setting, "profile": profile, **shared}


def _training_bars(rows: list[Row], options: Options) -> list[Bar]:
    """At least 99.9 % after the last epoch, in every setting."""
    made = []
    for setting, name in SETTINGS.items():
        what, wanted = f"{EPOCHS} epochs, {name}", f">= {100 * LEAST:g} %"
        last = [row for row in picked(rows, setting=setting) if row.get("epochs") == EPOCHS]
        if not last:
            made.append(Bar(what, wanted, "not run", None))
            continue
        worst = min(last, key=lambda row: (row["bit_accuracy"], row["z"]))
        low, high = share_interval(round(worst["bit_accuracy"] * BITS), BITS)
        share = f"{100 * worst['bit_accuracy']:.2f} % ({100 * low:.1f} to {100 * high:.1f})"
        said = f"{share}, z {worst['z']:.0f}, lowest of {len(last)} scenes"
        made.append(Bar(what, wanted, said, worst["bit_accuracy"] >= LEAST))
    return made


# --- Table 6: losses of the refinement -----------------------------------------------------------------------

STEPS, QUICK_STEPS = 100, 2
"""The paper runs 10,000; what more of them change is measured once, by the part `paper`."""
UNMARKED = Setting("unmarked", unmarked=True)
LOSSES = {
    "loss-text": (0.4, 1.0, 0.3),
    "loss-msg": (0.4, 0.0, 0.0),
    "loss-msg-rec": (0.4, 1.0, 0.0),
    "loss-appendix": (0.2, 0.5, 0.05),
}
"""Weights of the message, the pictures and their wavelets: the paper's text, parts of it, its appendix."""
PRINTED_LOSSES = {"unmarked": "none", "loss-msg": "msg", "loss-msg-rec": "msg+rec", "loss-text": "msg+rec+wavelet"}
"""Rows of the paper's table."""


def weights_of(loss: str) -> dict[str, float]:
    """One of LOSSES as fields of the refinement."""
    return dict(zip(("lambda_msg", "lambda_rec", "lambda_wavelet"), LOSSES[loss], strict=True))


def _losses(options: Options) -> list[Cell]:
    """The closed form, the unmarked model and every set of weights under every key."""
    steps = QUICK_STEPS if options.quick else STEPS
    refined = [Setting(loss, {"refine": {"steps": steps, **weights_of(loss)}}) for loss in LOSSES]
    every = [DEFAULT, UNMARKED, *refined]
    return setting_cells(options, every[:3] if options.quick else every)


def _loss_bars(rows: list[Row], options: Options) -> list[Bar]:
    """No claim on the unmarked model."""
    of = [row for row in picked(rows, setting=UNMARKED.name) if "claimed" in row]
    if not of:
        return []
    claims = sum(row["claimed"] for row in of)
    largest = max(row["z"] for row in of)
    return [Bar("unmarked model, claims", "0", f"{claims} of {len(of)} readings, largest z {largest:.2f}", claims == 0)]


# --- Figure 6: the paper's thresholds ------------------------------------------------------------------------

DOUBTS, PAPER_STEPS = (0.8, 1.0, 1.1, 1.2, 1.4, 1.6), 100
"""tau_unc of the paper's figure, and the Adam steps of these points."""


def _thresholds(options: Options) -> list[Cell]:
    """tau_unc in the paper's own system; tau_occ in pictures of ours."""
    steps = {"refine": {"steps": PAPER_STEPS}}
    doubts = [
        Setting(f"doubt-{tau:g}", {"paper": {"tau_unc": tau}, **steps}, profile="paper")
        for tau in (() if options.quick else DOUBTS)
    ]
    return [*setting_cells(options, doubts), *stopping.cells(options)]


PARTS: tuple[Part, ...] = (
    Part("table1", ("Table 1",), _lengths, _length_bars),
    Part("table2", ("Table 2",), _attacks, attack_bars),
    Part("table3", ("Table 3",), _costs, _cost_bars),
    Part("table4", ("Table 4",), _kinds, _kind_bars),
    Part("table5", ("Table 5",), _trainings, _training_bars),
    Part("table6", ("Table 6",), _losses, _loss_bars),
    Part("fig6", ("Figure 6",), _thresholds),
)
"""All but the paper's own system, which `as_paper` has."""
