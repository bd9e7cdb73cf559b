"""Suite 5 (the paper's Figure 5): can it be seen, without the key, that there is a mark?

Full, on 2 cores and a scene of 100k Gaussians: 2 keys x 100 renders about 2 minutes; the learned detector, 4 + 4 keys,
about 1 minute for each of the three forms and two baselines. With several scenes a stranger is tried as well. Quick:
24 renders, one key and one form, about half a minute.
"""

from engine.evaluate.steganalysis.reporting import report
from engine.evaluate.study import Cell, Options, Study

__all__ = ["STUDY"]

HERE = "engine.evaluate.steganalysis"
FORMS = ("floats", "own format", "lattice lost")
BASELINES = ("qim", "spread")
PROFILE = "fast"


def cells(options: Options) -> list[Cell]:
    """Renders of each scene and key; insiders of each scene and form; strangers over all scenes."""
    made = []
    seeds, views, checked, size, keys = (1, 24, 3, 256, 1) if options.quick else (2, 100, 10, 512, 4)
    for number, path in enumerate(options.scenes):
        for seed in range(options.seed, options.seed + seeds):
            arguments = {
                "path": path,
                "profile_name": PROFILE,
                "views": views,
                "checked_views": checked,
                "size": size,
                "seed": seed,
            }
            made.append(Cell(f"renders-{number}-{seed}", f"{HERE}.renders:look_at_renders", arguments))
        insider = {"path": path, "profile_name": PROFILE, "keys": keys, "seed": options.seed}
        cases = [("ours", form) for form in (FORMS[:1] if options.quick else FORMS)]
        cases += [] if options.quick else [(method, FORMS[0]) for method in BASELINES]
        for method, form in cases:
            name = f"insider-{number}-{method}-{form.replace(' ', '-')}"
            arguments = {**insider, "form": form, "method": method}
            made.append(Cell(name, f"{HERE}.learned:detect_as_insider", arguments))
    if len(options.scenes) > 1:
        for form in FORMS[:1] if options.quick else FORMS:
            arguments = {
                "paths": list(options.scenes),
                "profile_name": PROFILE,
                "form": form,
                "keys": max(1, keys // 2),
                "seed": options.seed,
            }
            name = f"stranger-{form.replace(' ', '-')}"
            made.append(Cell(name, f"{HERE}.learned:detect_as_stranger", arguments))
    return made


STUDY = Study(
    "steganalysis",
    "Can the mark be seen without the key?",
    "Do detectors without the key, on renders or on the model's own numbers, do better than a coin?",
    cells,
    report,
)
