"""Settings of an embedding, and the three named points on one curve of speed against accuracy (DESIGN 10)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

from engine.compress.hvq import HvqConfig
from engine.compress.pruning import PruneConfig
from engine.errors import InputError
from engine.watermark.planning import PlanConfig


@dataclass(frozen=True)
class RefineConfig:
    """Knobs of the refinement (Eq 9). No profile uses it: the closed-form mark reads as well without
    (docs/RESULTS.md, ablation).
    """

    steps: int = 0  # Adam steps; 0 leaves the closed-form mark as it is
    # Weights of the three losses (paper's text: 0.4, 1.0, 0.3; its appendix: 0.2, 0.5, 0.05)
    lambda_msg: float = 0.4
    lambda_rec: float = 1.0
    lambda_wavelet: float = 0.3
    rate: float = 4e-4  # Adam step in SH units, before the uncertainty's scaling
    size: int = 400  # side of the refined views, pixels


@dataclass(frozen=True)
class EmbedConfig:
    """Everything an embedding can be told."""

    psnr_db: float = 47.0  # wanted PSNR of the mark in the worst view, against the unmarked render
    ssim: float = 0.998  # wanted SSIM of the mark in the worst view
    output: str = "fidelity"  # "fidelity" keeps each Gaussian's own residual, "compact" drops it
    compact_db: float = 40.0  # with "compact": least PSNR of the delivered model against the original, worst view
    views: int = 8  # key views at which the mark is shaped
    view_size: int = 800  # side of a key view, pixels
    landmark_views: int = 48  # views of the landmark bank by which the camera of a screenshot is found; 0 leaves it out
    # Knobs of those stages
    quantize: HvqConfig = field(default_factory=HvqConfig)
    prune: PruneConfig = field(default_factory=PruneConfig)
    plan: PlanConfig = field(default_factory=PlanConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)

    def __post_init__(self) -> None:
        if self.output not in ("fidelity", "compact"):
            raise InputError(f"output must be 'fidelity' or 'compact', got {self.output!r}")
        if not 20.0 <= self.psnr_db <= 90.0:
            raise InputError(f"psnr must lie between 20 and 90 dB, got {self.psnr_db}")
        if self.prune.budget_db is not None and not 15.0 <= self.prune.budget_db <= 80.0:
            raise InputError(f"budget must lie between 15 and 80 dB or be 'none', got {self.prune.budget_db}")


PROFILES: dict[str, EmbedConfig] = {
    "fast": EmbedConfig(views=6),
    "balanced": EmbedConfig(views=10),
    "strong": EmbedConfig(views=16, psnr_db=45.0, ssim=0.997),
}
"""fast and balanced differ in how many views shape the mark; strong spends 2 dB of fidelity on evidence."""


AUTO = "auto"
"""The name under which a profile is left to the scene."""


@dataclass(frozen=True)
class Auto:
    """Settings that a rehearsal on the scene chooses (`engine.pipeline.choosing`)."""

    # Where to start from; its views, view size and (unless `keep_psnr`) fidelity are chosen anew
    start: EmbedConfig = PROFILES["fast"]
    keep_psnr: bool = False  # the owner named this fidelity: evidence may not be bought with it


Settings = EmbedConfig | Auto
"""What an embedding is told: everything, or to choose."""


def profile(name: str, **changes: Any) -> EmbedConfig:
    """A named profile with some knobs changed; an unknown name is an InputError."""
    if name not in PROFILES:
        raise InputError(f"unknown profile {name!r}, choose one of {', '.join(sorted(PROFILES))}")
    return replace(PROFILES[name], **changes)


def compose(
    name: str,
    *,
    psnr_db: float | None = None,
    output: str | None = None,
    budget_db: float | None = None,
    knobs: Sequence[str] = (),
) -> Settings:
    """A named profile, or `auto`, with what an owner asked for; None leaves the profile's own.

    `knobs` are texts like ``"quantize.cells=1024"``, any knob that `mark3dgs config show` lists.
    """
    asked = {"psnr_db": psnr_db, "output": output}
    changes: dict[str, Any] = {knob: value for knob, value in asked.items() if value is not None}
    config = replace(Auto().start, **changes) if name == AUTO else profile(name, **changes)
    if budget_db is not None:
        config = replace(config, prune=replace(config.prune, budget_db=budget_db))
    for knob in knobs:
        config = _turned(config, *knob.partition("=")[::2])
    keep_psnr = psnr_db is not None or any(knob.startswith("psnr_db=") for knob in knobs)
    return Auto(config, keep_psnr) if name == AUTO else config


def _turned(config: Any, knob: str, text: str, depth: int = 0) -> Any:
    """A configuration with one knob, ``name`` or ``stage.name``, at the value that a text says."""
    parts = knob.split(".")
    name, last = parts[depth], depth == len(parts) - 1
    if name not in (field.name for field in fields(config)) or is_dataclass(now := getattr(config, name)) == last:
        raise InputError(f"there is no knob {knob!r}; `mark3dgs config show` lists them")
    return replace(config, **{name: _parsed(knob, text, now) if last else _turned(now, knob, text, depth + 1)})


def _parsed(knob: str, text: str, now: Any) -> Any:
    """A text as a value of the kind that the knob has; `budget_db`, which may be none, is a number."""
    try:
        if isinstance(now, str):
            return text
        if isinstance(now, tuple):
            return tuple(int(part) for part in text.split(",") if part not in ("", "-"))
        if knob == "prune.budget_db" and text == "none":
            return None
        return int(text) if isinstance(now, int) else float(text)
    except ValueError:
        raise InputError(f"{knob} is {now!r} and cannot be {text!r}") from None
