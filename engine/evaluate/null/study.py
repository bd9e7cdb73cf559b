"""Suite 4: calibration. Does the measured rate of false claims keep below the stated bound, whatever is tried?

Full: about 20 suspects with a million wrong keys each, 10,000 other recipients, power from thinned models and from
bad pictures, a detector that must fail, forged originals, an oracle, and the search for the mark in the numbers of the
file: about 10 minutes a scene of 100k Gaussians on 2 cores. Quick: the same with 100,000 keys, few trials, small views.
"""

from typing import Any

from engine.evaluate.null.report import report
from engine.evaluate.null.suspects import FOUND
from engine.evaluate.study import Cell, Options, Study

__all__ = ["STUDY"]

SHARES = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0005, 0.00025)
PICTURES = (1, 2, 4, 8, 16)


def cells(options: Options) -> list[Cell]:
    """One cell for each kind of suspect and scene; each pair of neighbouring scenes once."""
    quick = options.quick
    work: dict[str, tuple[str, dict[str, Any]]] = {
        **{
            f"found-{name}": ("suspects:try_found", {"name": name, "keys": 100_000 if quick else 1_000_000})
            for name in FOUND
        },
        "crafted": ("suspects:try_crafted", {"keys": 100_000 if quick else 1_000_000}),
        "copies": ("suspects:try_copies", {"copies": 200 if quick else 10_000}),
        "wrong-detector": ("counterexamples:rebuild_reference", {"keys": 5 if quick else 100}),
        "forged": ("counterexamples:forge_original", {}),
        "oracle": ("counterexamples:ask_oracle", {"repeats": 1 if quick else 10}),
        "gaussians": (
            "power_curves:few_gaussians",
            {"shares": list(SHARES[2:5] if quick else SHARES), "trials": 2 if quick else 20},
        ),
        "pictures": (
            "power_curves:few_pictures",
            {"counts": list(PICTURES[:2] if quick else PICTURES), "draws": 20 if quick else 200},
        ),
        "attributes": (
            "detectability:compare_attributes",
            {"samples": 60 if quick else 400, "draws": 19 if quick else 199, "keys": 1 if quick else 2},
        ),
    }
    made = []
    for number, path in enumerate(options.scenes):
        common = {"path": path, "quick": quick, "seed": options.seed}
        for name, (function, arguments) in work.items():
            made.append(Cell(f"{number}-{name}", f"engine.evaluate.null.{function}", {**common, **arguments}))
        if len(options.scenes) > 1:
            other = {"other": options.scenes[(number + 1) % len(options.scenes)]}
            made.append(Cell(f"{number}-pair", "engine.evaluate.null.suspects:try_pairs", {**common, **other}))
    return made


STUDY = Study(
    "null",
    "Truth: measured false claims against the proven bound",
    "Does any key that had no part in a suspect claim it, and what does it take for the right key to do so?",
    cells,
    report,
)
