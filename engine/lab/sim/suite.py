"""Running attacks on a marked model: bits, z, claim, and what the attacker paid. The list is in `suite.toml`.

Extraction is informed: every row was read with the owner's record.
"""

import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.search import Verification, VerifyConfig, verify_images, verify_model
from engine.lab.sim.adversaries.collusion import NEED_COPIES
from engine.lab.sim.attack import Label, Strength
from engine.lab.sim.attack_cost import CHEAP_DB, Cost, image_cost, model_cost
from engine.lab.sim.attacks import image_attack, model_attack
from engine.model import Float32, GaussianModel

Step = tuple[str, Strength]
"""Name and strength of an attack of the registry."""

Row = dict[str, Any]
"""One line of the study's JSON table; see `run_suite`."""

WITHOUT_COST = {"merge_into", "crop_image", "rotate_image", "scale_image"}
"""Steps that only move, cut or surround what is stolen: left out when the look is judged."""


@dataclass(frozen=True)
class Trial:
    """One line of the suite."""

    label: str
    chain: tuple[Step, ...]  # attacks in order, each by name and strength
    source: str  # whose attack it is: the work in which it, or its strength, stands
    # what is attacked; in a copy attack, what is framed is another model
    kind: Literal["model", "image", "copy attack"] = "model"
    reading: Label = "literal"  # of all steps that have it; the others run literally
    copies: int = 0  # copies of the asset that are needed in addition to the subject's own


def _read_suite() -> tuple[Trial, ...]:
    tables = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    trials = []
    for row in tables["suite"]["trials"]:
        chain = tuple((name, strength) for name, strength in row["chain"])
        trials.append(Trial(**{**row, "source": tables["sources"][row["source"]], "chain": chain}))
    return tuple(trials)


SUITE = _read_suite()
"""All trials, in the order of a table: placed, cut and added to, changed in value, attacked on purpose, chains,
pictures."""


class Subject(Protocol):
    """A marked scene to attack: its name in the table, what attackers get, and the owner's record."""

    @property
    def name(self) -> str: ...

    @property
    def marked(self) -> GaussianModel: ...

    @property
    def opened(self) -> OpenedRecord: ...


@dataclass(frozen=True, eq=False)
class Company:
    """What some attacks need in addition to the stolen model."""

    copies: Sequence[GaussianModel] = field(default_factory=tuple)  # other recipients' copies of the same asset
    # another, unmarked model: the scene merged into, and the victim of the copy attack
    other: GaussianModel | None = None


def apply_chain(
    target: GaussianModel | Float32,
    trial: Trial,
    seed: int | Sequence[int],
    *,
    company: Company = Company(),
    source: GaussianModel | None = None,
    skip: Iterable[str] = (),
) -> Any:
    """The model, or picture (H, W, 3), after all steps of a trial, each with a random stream of its own.

    A copy attack lifts from the marked model `source`. Attacks in `skip` are left out; the others keep their streams.
    """
    find = image_attack if trial.kind == "image" else model_attack
    for number, (name, strength) in enumerate(trial.chain):
        if name in skip:
            continue
        attack: Any = find(name)
        options: dict[str, object] = {}
        if name in NEED_COPIES:
            options["others"] = company.copies[: trial.copies]
        elif name == "transplant":
            options["source"] = source
        elif name == "merge_into" and company.other is not None:
            options["other"] = company.other
        labels = [reading.label for reading in attack.readings]
        reading = trial.reading if trial.reading in labels else None
        rng = np.random.default_rng((seed, number))
        target = attack.apply(target, strength, rng=rng, reading=reading, **options)
    return target


def run_suite(
    subject: Subject,
    trials: Sequence[Trial],
    *,
    company: Company = Company(),
    config: VerifyConfig = VerifyConfig(),
    pictures: int = 2,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> list[Row]:
    """Attack, judge the look, verify; one row for each trial.

    Image attacks are tried on so many `pictures`, key views, each alone; the row is that of the lowest z. `advance` is
    called with the fraction done.

    A row: scene, attack, kind, reading, source, verdict, expected, bit_accuracy, z, log10_false_claim,
    derived_fraction, route, seconds (of the verification), the fields of `Cost` (None where there is nothing to judge),
    and `outcome`: "held", "ruined" (no claim, but the look went with it), "removed" (no claim, look kept) or, where a
    claim would be false, "framed"; "not run: ..." where the company lacks what the trial needs.
    """
    if not 1 <= pictures <= len(subject.opened.cameras):
        raise InputError(f"the record has {len(subject.opened.cameras)} key views, {pictures} are wanted")
    rows = []
    for number, trial in enumerate(trials):
        rows.append({"scene": subject.name, **_run(subject, trial, company, config, pictures, seed)})
        if advance:
            advance((number + 1) / len(trials))
    return rows


def failures_first(rows: Sequence[Row]) -> list[Row]:
    """Rows by how bad they are for the owner: false claims, removed, ruined, held; then the lowest z first."""
    rank = {"framed": 0, "removed": 1, "ruined": 2, "held": 3}
    return sorted(rows, key=lambda row: (rank.get(row["outcome"], 4), row.get("z") or 0.0))


def _run(subject: Subject, trial: Trial, company: Company, config: VerifyConfig, pictures: int, seed: int) -> Row:
    about = {
        "attack": trial.label,
        "kind": trial.kind,
        "reading": trial.reading,
        "source": trial.source,
        "expected": "not marked" if trial.kind == "copy attack" else "marked",
    }
    lacking = _lacking(trial, company)
    if lacking:
        return {**about, "outcome": f"not run: {lacking}"}
    if trial.kind == "image":
        tried = [_on_picture(subject, trial, config, view, seed) for view in range(pictures)]
        result, cost = min(tried, key=lambda pair: pair[0].claim.z)
    else:
        result, cost = _on_model(subject, trial, company, config, seed)
    claim = result.claim
    return {
        **about,
        "outcome": _outcome(trial, claim.verdict.value == "marked", cost),
        "verdict": claim.verdict.value,
        "bit_accuracy": claim.bit_accuracy,
        "z": claim.z,
        "log10_false_claim": claim.log10_false_claim,
        "derived_fraction": claim.derived_fraction,
        "route": claim.route,
        "seconds": result.seconds,
        **asdict(cost),
    }


def _lacking(trial: Trial, company: Company) -> str:
    if len(company.copies) < trial.copies:
        return f"needs {trial.copies} further copies, there are {len(company.copies)}"
    if trial.kind == "copy attack" and company.other is None:
        return "needs another model to frame"
    return ""


def _on_model(
    subject: Subject, trial: Trial, company: Company, config: VerifyConfig, seed: int
) -> tuple[Verification, Cost]:
    stolen = subject.marked
    if trial.kind == "copy attack" and company.other is not None:
        stolen = company.other
    suspect = apply_chain(stolen, trial, seed, company=company, source=subject.marked)
    judged = suspect
    if any(name in WITHOUT_COST for name, _ in trial.chain):
        judged = apply_chain(stolen, trial, seed, company=company, source=subject.marked, skip=WITHOUT_COST)
    return verify_model(suspect, subject.opened, config), model_cost(stolen, judged, seed=seed)


def _on_picture(
    subject: Subject, trial: Trial, config: VerifyConfig, view: int, seed: int
) -> tuple[Verification, Cost]:
    from engine.raster import render

    camera = subject.opened.cameras[view]
    picture = _stored(render(subject.marked, camera))
    suspect = _stored(apply_chain(picture, trial, seed))
    judged = _stored(apply_chain(picture, trial, seed, skip=WITHOUT_COST))
    return verify_images([suspect], subject.opened, config, cameras=[camera]), image_cost(picture, judged)


def _stored(image: Float32) -> Float32:
    """What an 8-bit file holds."""
    return (np.round(np.clip(image, 0, 1) * 255) / 255).astype(np.float32)


def _outcome(trial: Trial, claimed: bool, cost: Cost) -> str:
    if trial.kind == "copy attack":
        return "framed" if claimed else "held"
    if claimed:
        return "held"
    look = cost.psnr if cost.covered_psnr is None else max(cost.psnr, cost.covered_psnr)
    return "removed" if look >= CHEAP_DB else "ruined"
