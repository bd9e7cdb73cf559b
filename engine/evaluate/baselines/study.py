"""Suite 6: other methods on the same scenes, at the same fidelity, under the same attacks.

Full: 3 keys of ours and of each method, 16 attacks on the model and 9 on each of 3 pictures, 100 wrong keys; on 2 cores
and a scene of 100k Gaussians about 20 minutes, 35 where RivaGAN is installed. Quick: one key, few attacks, small views.
"""

from engine.evaluate.baselines.methods import METHODS
from engine.evaluate.baselines.reporting import report
from engine.evaluate.study import Cell, Options, Study

__all__ = ["STUDY"]

HERE = "engine.evaluate.baselines.measuring"


def cells(options: Options) -> list[Cell]:
    """One cell for each scene, method and key."""
    keys, pictures, wrong_keys = (1, 1, 5) if options.quick else (3, 3, 100)
    made = []
    for number, path in enumerate(options.scenes):
        for seed in range(options.seed, options.seed + keys):
            shared = {"path": path, "seed": seed, "pictures": pictures, "quick": options.quick}
            made.append(Cell(f"{number}-ours-{seed}", f"{HERE}:attack_ours", shared))
            for method in METHODS:
                arguments = {**shared, "method": method, "wrong_keys": wrong_keys}
                made.append(Cell(f"{number}-{method}-{seed}", f"{HERE}:attack_baseline", arguments))
    return made


STUDY = Study(
    "baselines", "Other methods, here", "What do other ways of marking keep, where ours is measured?", cells, report
)
