"""The benches of `mark3dgs bench`, as cells that run, are stored and are resumed like those of every study."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from engine.errors import InputError
from engine.lab.evaluate.study import Cell

TRIALS = {
    "trials": 50,
    "epochs": 500,
    "keys": 100_000,
    "innocents": 10_000,
    "assets": 1_000,
    "questions": 300,
    "pictures": 200,
}
"""What `--trials` counts in different benches, and how many unless told otherwise."""


@dataclass(frozen=True)
class Bench:
    """One bench: rows of a ``"module:function"`` of this package."""

    summary: str
    work: str
    told: tuple[str, ...] = ("profile",)
    """Options that it takes and that its report repeats; those in TRIALS take their number from `--trials`."""
    untold: tuple[str, ...] = ()
    """Options that it takes and its report leaves to the rows."""
    settings: str = ""
    """``"package.module:NAME"`` of what `--setting` chooses from, a cell for each; and the paper's table of them."""
    table: str = ""
    scenes: Literal["each", "together", "beside the next", "beside another"] = "each"
    """A cell for each, or one for all; with `other`, the scene after it (None where it is alone), or with the spare one
    in place of None."""


BENCHES = {
    "raster": Bench(
        "milliseconds forward and backward, against a plain loop", "raster:measure_raster", ("repeats",), ("size",)
    ),
    "embed": Bench("seconds by stage and peak memory", "timing:measure_embed", ("profile", "repeats")),
    "verify": Bench(
        "seconds for a model, a picture, a screenshot of unknown camera",
        "timing:measure_verify",
        ("profile", "repeats"),
    ),
    "fidelity": Bench(
        "dB, SSIM and bits for every message length, compact output and pruning budgets", "marking:measure_fidelity"
    ),
    "attacks": Bench("bits, z and claim after every attack of the bars", "attacks:measure_attacks"),
    "screenshots": Bench(
        "claims from pictures of unknown camera, and from another scene's",
        "attacks:measure_screenshots",
        ("profile", "trials"),
        scenes="beside the next",
    ),
    "foreign": Bench(
        "pictures of the unmarked asset, of another scene, of lumps and photographs: claims and recognitions",
        "foreign:measure_foreign",
        ("profile", "pictures"),
        scenes="beside the next",
    ),
    "finetune": Bench(
        "claims after training on clean or own pictures, at the key views or others (Table 5)",
        "training:measure_fine_tuning",
        ("profile", "epochs"),
        ("colors_only",),
        "engine.lab.sim.adversaries.retraining:SETTINGS",
        "Table 5",
    ),
    "truth": Bench(
        "false claims among wrong keys, against the proven bound",
        "truth:measure_truth",
        ("profile", "keys"),
        scenes="together",
    ),
    "suite": Bench(
        "every attack of the simulator, with what it costs the attacker; failures first",
        "attacks:measure_suite",
        scenes="beside another",
    ),
    "variants": Bench(
        "2DGS, 4DGS, Compact3D and DreamGaussian models, made from the scene (Table 4)",
        "marking:measure_variants",
        (),
        settings="engine.lab.evaluate.bench.marking:VARIANTS",
        table="Table 4",
    ),
    "collusion": Bench(
        "buyers who put their copies together: who is named, and whether an innocent is",
        "truth:measure_collusion",
        ("innocents",),
    ),
    "screening": Bench(
        "which of many assets is it? ranks, seconds, bytes",
        "screening:measure_screening",
        ("assets",),
        scenes="together",
    ),
    "removal": Bench("what it costs to take the mark out without a key, in decibels", "removal:measure_removal"),
    "oracle": Bench(
        "what it saves who takes it out to be told whether the mark is still there, so many times",
        "oracle:measure_oracle",
        ("profile", "questions"),
    ),
    "retrain": Bench("claims from fresh models trained on renders of the marked one", "training:measure_retraining"),
    "life": Bench("speed of physics and of training", "timing:measure_life", (), ("repeats",)),
}


def bench_cells(
    name: str, scenes: Sequence[str], asked: dict[str, Any], *, seed: int, settings: Sequence[str], spare: str
) -> tuple[list[Cell], dict[str, Any]]:
    """The cells of a bench, and what its report says of how it was run.

    `asked` has the values of all options by name; `trials` is None for the bench's own number. Of a bench that has
    settings the named ones are run, all where none is named (InputError for one that there is not). The spare model is
    for a bench that needs another one beside the only one given.
    """
    bench = BENCHES[name]
    counts = {option: asked["trials"] or number for option, number in TRIALS.items()}
    told = {option: counts.get(option, asked.get(option)) for option in bench.told}
    shared = {**told, **{option: asked[option] for option in bench.untold}, "seed": seed}
    work = f"engine.lab.evaluate.bench.{bench.work}"
    if bench.scenes == "together":
        return [Cell(name, work, {"scenes": list(scenes), **shared})], told
    cells = []
    for number, (scene, after) in enumerate(zip(scenes, [*scenes[1:], scenes[0]], strict=True)):
        arguments = {"scene": scene, **shared}
        if bench.scenes in ("beside the next", "beside another"):
            alone = spare if bench.scenes == "beside another" else None
            arguments["other"] = after if after != scene else alone
        for setting in _settings(bench, settings):
            own = {"setting": setting} if setting else {}
            parts = [name, str(number), Path(scene).stem, setting]
            said = "-".join("".join(c if c.isalnum() else "_" for c in part) for part in parts if part)
            cells.append(Cell(said, work, {**arguments, **own}))
    return cells, told


def _settings(bench: Bench, wanted: Sequence[str]) -> list[str]:
    if not bench.settings:
        return [""]
    module, _, table = bench.settings.partition(":")
    known = getattr(import_module(module), table)
    if unknown := [name for name in wanted if name not in known]:
        raise InputError(f"{bench.table} has no setting {unknown[0]!r}; it has {', '.join(known)}")
    return list(wanted) or list(known)
