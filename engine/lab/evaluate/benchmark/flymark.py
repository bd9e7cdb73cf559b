"""FlyMark's ten families of attacks on models (2026, its appendix B.4): the area below the bits over the severities.

Of each family the clean model comes first and severities are equally far apart, whatever their values; families count
alike. Keys 17, 29, 43 and seeds 101, 202, 303 are FlyMark's. That the area is of the share of bits read right is our
reading. About 200 verifications a scene and method; quick: one key, one seed, one severity a family.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from engine.flows.views.camera_rig import measure_extent
from engine.lab.evaluate.benchmark.methods import BITS, OURS, mark_subject, scenes_and_methods
from engine.lab.evaluate.study import Bar, Cell, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import grouped, listed, picked
from engine.lab.sim.attacks import model_attack
from engine.model import SH_C0, GaussianModel

__all__ = ["FAMILIES", "STUDY", "area_of", "measure"]

KEYS, SEEDS = (17, 29, 43), (101, 202, 303)
PUBLISHED, LEAST = 0.899, 0.999
"""Macro AUC: FlyMark's own (of blind bits; RandomCone .875, SpatialHash .709), and our bar."""
FLYMARK = {"injection": 0.793, "opacity prune": 0.733, "position noise": 0.767, "random prune": 0.767}
"""AUC of those families that the paper prints."""

Attack = Callable[[GaussianModel, float, np.random.Generator], GaussianModel]


def _registered(name: str) -> Attack:
    return lambda model, severity, rng: model_attack(name).apply(model, severity, rng=rng)


def _fade(model: GaussianModel, severity: float, rng: np.random.Generator) -> GaussianModel:
    """Opacities times 1 + N(0, severity^2)."""
    opacities = model.opacities.astype(np.float64) * (1.0 + severity * rng.standard_normal(len(model)))
    opacities = np.clip(opacities, 1e-6, 1.0 - 1e-6)
    return model.with_(opacity_logits=np.log(opacities / (1.0 - opacities)).astype(np.float32))


def _shake(model: GaussianModel, severity: float, rng: np.random.Generator) -> GaussianModel:
    """Centres + N(0, (severity rho)^2), rho the 95th percentile of distances from the middle."""
    extent = measure_extent(model)
    rho = float(np.quantile(np.linalg.norm(model.means - extent.center, axis=1), 0.95))
    return model_attack("noise_position").apply(model, severity * rho / extent.radius, rng=rng)


def _round_colors(model: GaussianModel, severity: float, rng: np.random.Generator) -> GaussianModel:
    """DC colours, 0 to 1, in so many bits a channel."""
    levels = 2.0**severity - 1.0
    colors = np.clip(0.5 + SH_C0 * model.sh[:, 0].astype(np.float64), 0.0, 1.0)
    return model.with_dc((np.round(colors * levels) / levels - 0.5) / SH_C0)


FAMILIES: dict[str, tuple[Attack, tuple[float, ...], bool]] = {
    "random prune": (_registered("prune_random"), (0.1, 0.3, 0.5, 0.7), True),
    "opacity prune": (_registered("prune_opacity"), (0.1, 0.3, 0.5), False),
    "injection": (_registered("inject"), (0.05, 0.1, 0.3), True),
    "DC noise": (_registered("noise_dc"), (0.005, 0.01, 0.02), True),
    "opacity noise": (_fade, (0.05, 0.1, 0.2), True),
    "position noise": (_shake, (0.001, 0.005, 0.01), True),
    "float16": (_registered("round_floats"), (10,), False),
    "color bits": (_round_colors, (8, 6, 4), False),
    "SH degree": (_registered("drop_sh"), (2, 1, 0), False),
    "reorder": (_registered("shuffle"), (1.0,), True),
}
"""Attack, severities from mild to strong, and whether it draws by lot: then all seeds are tried."""
CLEAN = "clean"


def measure(path: str, method: str, key: int, quick: bool) -> list[Row]:
    """A row for the marked model, and one for each severity and seed."""
    subject = mark_subject(method, path, key)
    about = {"scene": Path(path).name, "method": subject.method.name, "informed": subject.method.informed, "key": key}

    def row(family: str, step: int, suspect: GaussianModel) -> Row:
        right, claimed, z = subject.read_model(suspect) or (None, None, None)
        return {**about, "family": family, "step": step, "right": right, "claimed": claimed, "z": z}

    rows = [row(CLEAN, 0, subject.marked)]
    for family, (attack, severities, drawn) in FAMILIES.items():
        for step, severity in enumerate(severities[-1:] if quick else severities, 1):
            for seed in SEEDS if drawn and not quick else SEEDS[:1]:
                suspect = attack(subject.marked, severity, np.random.default_rng((seed, step)))
                rows.append({**row(family, step, suspect), "severity": severity, "seed": seed})
    return rows


def area_of(clean: Sequence[Row], family: Sequence[Row]) -> float:
    """Of the mean share of bits over equally spaced severities, the clean model first: 0 to 1, 0.5 is chance."""
    steps = [clean, *grouped(family, "step").values()]
    shares = [float(np.mean([row["right"] for row in rows])) / BITS for rows in steps]
    return float(np.trapezoid(shares) / (len(shares) - 1))


def _cells(options: Options) -> list[Cell]:
    return [
        Cell.of(f"{name}-{key}", measure, **which, key=key, quick=options.quick)
        for name, which in scenes_and_methods(options)
        for key in (KEYS[:1] if options.quick else KEYS)
    ]


def _report(rows: list[Row], options: Options) -> Report:
    bars, lines, unread = [], [], []
    for (scene, method), own in grouped(rows, "scene", "method").items():
        if any(row["right"] is None for row in own):
            unread.append(f"{method} reads no models.")
            continue
        clean = picked(own, family=CLEAN)
        areas = {family: area_of(clean, picked(own, family=family)) for family in FAMILIES}
        macro = float(np.mean(list(areas.values())))
        claims = f"{sum(row['claimed'] for row in own)} of {len(own)}"
        reading = "informed" if own[0]["informed"] else "blind"
        lines.append({"scene": scene, "method": method, "reading": reading, "macro AUC": f"{macro:.4f}"})
        lines[-1] |= {family: f"{area:.4f}" for family, area in areas.items()} | {"claims": claims}
        if method == OURS:
            lost = [f"{row['family']} {row['severity']:g}" for row in own if not row["claimed"] and "severity" in row]
            measured = f"{macro:.4f}; {claims} claim{': not ' + ', '.join(sorted(set(lost))) if lost else ''}"
            bars.append(Bar(f"{scene}: macro AUC of bits", f">= {LEAST} ({PUBLISHED})", measured, macro >= LEAST))
    printed = ", ".join(f"{family} {area}" for family, area in FLYMARK.items())
    text = f"FlyMark prints {PUBLISHED} of its own, blind reading, on other scenes; of its families {printed}."
    return Report(bars, [Section("Area below the bits over the severities", [text, *unread], [listed(lines)])])


STUDY = Study(
    "flymark",
    "FlyMark's protocol",
    "How many bits outlast ten families of attacks on models, as FlyMark counts them?",
    _cells,
    _report,
    frozenset({"quick", "methods"}),
)
