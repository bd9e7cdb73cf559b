"""The paper's own system, run: the same measurements under it, in cells whose rows no other part takes for ours."""

import importlib
from dataclasses import asdict
from typing import Any

from engine.lab.evaluate.study import Bar, Cell, Options, Row
from engine.lab.evaluate.summary import accuracy
from engine.lab.evaluate.tables.part import MEASURING, PROFILE, Part, Setting, changes_of, efforts, scenes_of
from engine.lab.evaluate.tables.parts import COLUMNS, LOSSES, QUICK_COLUMNS, training, weights_of
from engine.lab.evaluate.tables.parts import SETTINGS as TRAININGS

STEPS, QUICK_STEPS = 100, 2
"""Adam steps of a marking; the paper has 10,000, and what they change is measured by itself."""
MANY_STEPS = (0, 100, 1_000, 10_000)
STEPPED = ("paper", PROFILE)
"""Profiles under which that is measured: the paper's and ours."""
LENGTHS = (16, 32, 48)
GAMMAS = (0.0, 0.1, 0.2, 0.3, 0.5)
ZETAS = (28.52, 37.0, 47.0)
"""PSNR of the mark, dB, in place of the paper's zeta: that of its own table, and two fainter ones."""


def measure(part: str, name: str, work: str, arguments: dict[str, Any]) -> list[Row]:
    """What another cell's function gives, wrapped: ``as_paper`` (table or figure), ``name`` (setting), ``row``."""
    module, _, function = work.partition(":")
    rows: list[Row] = getattr(importlib.import_module(module), function)(**arguments)
    return [{"as_paper": part, "name": name, "row": row} for row in rows]


def paper(name: str, *, quick: bool, bits: int = 32, profile: str = "paper", **changes: Any) -> Setting:
    """The paper's system with some settings changed, nested as its stages are."""
    refine = {"steps": QUICK_STEPS if quick else STEPS, **changes.pop("refine", {})}
    return Setting(f"paper-{name}", {"refine": refine, **changes}, bits=bits, profile=profile)


def settings(options: Options) -> dict[tuple[str, str], Setting]:
    """Every marking, by table and by what it is called there."""
    quick = options.quick
    made = {("table1", str(bits)): paper(f"bits-{bits}", quick=quick, bits=bits) for bits in LENGTHS}
    if quick:
        return {key: setting for key, setting in made.items() if key[1] == "32"}
    made["table1", "32, appendix"] = paper("appendix", quick=quick, profile="paper-appendix")
    for loss in LOSSES:
        if loss != "loss-appendix":
            made["table6", loss] = paper(loss, quick=quick, refine=weights_of(loss))
    for gamma in GAMMAS:
        made["fig7", f"gamma {gamma:g}"] = paper(f"gamma-{gamma:g}", quick=quick, prune={"gamma": gamma})
    for db in ZETAS:
        made["fig7", f"{db:g} dB"] = paper(f"psnr-{db:g}", quick=quick, psnr_db=db, ssim=0.0)
    return made


def cells(options: Options) -> list[Cell]:
    """Tables 1, 2, 3, 5 and 6 and figure 7; and on the main scene, what more steps change."""
    effort, _ = efforts(options)
    changes, columns = changes_of(options), list(QUICK_COLUMNS if options.quick else COLUMNS)
    usual = asdict(paper("paper", quick=options.quick))
    made = []
    for short, path in scenes_of(options):
        on = {"scene": path, "seed": options.seed, "changes": changes}
        seen = {**on, "views": effort.views, "size": effort.size}
        for (part, name), setting in settings(options).items():
            marked = {**seen, "setting": asdict(setting), "attacked": part != "table1"}
            made.append(_cell(part, name, f"{part}-{setting.name}-{short}", "measure_setting", marked))
        attacked = {"columns": columns, "setting": usual}
        made.append(_cell("table2", "pictures", f"pictures-{short}", "attack_pictures", {**seen, **attacked}))
        made.append(_cell("table2", "models", f"models-{short}", "attack_models", {**on, **attacked}))
        if options.quick:
            continue
        costs = {"profile": "paper", "repeats": 1, "width": 1297, "height": 840}
        steps = {"changes": {"refine": {"steps": STEPS}}}
        made.append(_cell("table3", "costs", f"costs-{short}", "measure_costs", {**on, **costs, **steps}))
        for name in TRAININGS:
            work, arguments = training(path, name, options, "paper", {**changes, **steps["changes"]})
            made.append(_cell("table5", name, f"training-{name.replace('+', '-and-')}-{short}", work, arguments))
    if not options.quick:
        short, path = next(scenes_of(options))
        on = {"scene": path, "seed": options.seed, "changes": changes, "views": 4, "size": 480}
        for name in STEPPED:
            for count in MANY_STEPS:
                setting = Setting(f"{name}-steps-{count}", {"refine": {"steps": count}}, profile=name)
                marked = {**on, "setting": asdict(setting), "attacked": True}
                made.append(
                    _cell("steps", f"{name} {count}", f"steps-{name}-{count}-{short}", "measure_setting", marked)
                )
    return made


def _cell(part: str, name: str, cell: str, work: str, arguments: dict[str, Any]) -> Cell:
    work = work if ":" in work else f"{MEASURING}:{work}"
    return Cell.of(f"as-paper-{cell}", measure, part=part, name=name, work=work, arguments=arguments)


def rows_as_paper(rows: list[Row], part: str, name: str | None = None) -> list[Row]:
    """The rows of a table or figure under the paper's system, unwrapped, each with its ``name``."""
    wrapped = [row for row in rows if row.get("as_paper") == part and name in (None, row["name"])]
    return [{**row["row"], "name": row["name"]} for row in wrapped]


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """Its own decoder reads every bit of the model that its own settings marked."""
    read = [row for row in rows_as_paper(rows, "table1") if row["kind"] == "marked"]
    found = accuracy(read, "right_by_eq10")
    if found is None:
        return []
    return [Bar("the paper's system, model, bits by Eq 10", "100 %", str(found), found.share == 1.0)]


PART = Part("paper", ("Figure 7", "Steps"), cells, bars)
