"""Suite 2: every attack from harmless to ruinous, odd inputs, and the same claim each time.

Full: about 90 sweeps of up to 5 strengths with 3 trials on models (each a key and a seed of its own) and 2 on pictures,
27 odd inputs in two roles, 4 child processes: about 25 minutes a scene of 100k Gaussians on 2 cores. Quick: three
sweeps, five odd inputs, one trial, small views.
"""

from engine.evaluate.stability.odd_inputs import ODD, QUICK
from engine.evaluate.stability.report import report
from engine.evaluate.stability.sweeps import all_sweeps, thinned
from engine.evaluate.study import Cell, Options, Study

__all__ = ["STUDY"]

MODEL_TRIALS, IMAGE_TRIALS = 3, 2
QUICK_SWEEPS = ("prune_random", "noise_dc", "jpeg")
ODD_A_CELL = 5


def cells(options: Options) -> list[Cell]:
    """One cell for each sweep and scene; odd inputs a handful at a time; two cells of sameness."""
    made = []
    for number, path in enumerate(options.scenes):
        common = {"path": path, "quick": options.quick, "seed": options.seed}
        for sweep in all_sweeps():
            if options.quick and sweep.name not in QUICK_SWEEPS:
                continue
            trials = MODEL_TRIALS if sweep.kind == "model" else IMAGE_TRIALS
            arguments = {
                "attack": sweep.attack,
                "reading": sweep.reading,
                "trials": 1 if options.quick else trials,
                "strengths": list(thinned(sweep.strengths, 3) if options.quick else sweep.strengths),
            }
            work = f"engine.evaluate.stability.attacking:sweep_{sweep.kind}s"
            made.append(Cell(f"{number}-{sweep.name}", work, {**common, **arguments}))
        for name in ("precision", "machines"):
            made.append(Cell(f"{number}-same-{name}", f"engine.evaluate.stability.sameness:compare_{name}", common))
        names = list(QUICK if options.quick else ODD)
        for start in range(0, len(names), ODD_A_CELL):
            part = {"names": names[start : start + ODD_A_CELL]}
            made.append(
                Cell(
                    f"{number}-odd-{start // ODD_A_CELL}",
                    "engine.evaluate.stability.stressing:stress",
                    {**common, **part},
                )
            )
    return made


STUDY = Study(
    "stability",
    "Stability: how far an attack must go before the mark breaks",
    "At which strength does each attack take bits, then the claim, and what has it cost the attacker by then?",
    cells,
    report,
)
