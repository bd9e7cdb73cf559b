"""Settings of an embedding: three named points on one curve of speed against accuracy (DESIGN 10), and the paper's."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from operator import attrgetter
from typing import Any, Self

from engine.compress.hvq import HvqConfig
from engine.compress.pruning import PruneConfig
from engine.errors import InputError
from engine.numerics.plain import Json
from engine.raster.cuda import DEVICES, find_device
from engine.watermark.planning import PlanConfig


@dataclass(frozen=True)
class RefineConfig:
    """Knobs of the refinement (Eq 9). Only the paper's profiles use it: the closed-form mark reads as well without
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
class PaperConfig:
    """What the paper does and we do not, stage by stage, with the reason why not; all off but in its own profiles."""

    # Threshold of Eq 5 as a fraction of the ranking, taken as it is, then merging; 0 prunes to the owner's budget.
    # Ours: a fixed threshold takes what it takes; this one leaves 16 dB of the shipped plant.
    tau_base: float = 0.0
    # Share of the Gaussians, those of the greatest W^freq, that are split. Ours: marks need no new Gaussians, files do
    # not want them.
    densify: float = 0.0
    # Cells and codes weigh Gaussians by W^freq. Ours: by the inverse Laplace uncertainty, the curvature of the error.
    frequency: bool = False
    # s of tau_unc = mean(U) + s std(U): coefficients more uncertain are left to the first stage; 0 leaves none. Ours:
    # codebooks carry no mark beyond the first stage, and "fidelity" keeps every coefficient.
    tau_unc: float = 0.0
    # The quantiser's code vectors carry the mark. Ours: cells that a copy's key joins, since public ones can be washed.
    public_codes: bool = False
    # SVD over all coefficients. Ours: DC alone, since formats drop or crush the others.
    whole_sh: bool = False
    # Refinement moves code vectors, held by Eq 6 and 7 with this weight (the paper names none), not single Gaussians;
    # 0: Gaussians. Ours: no refinement at all.
    codes: float = 0.0


@dataclass(frozen=True)
class EmbedConfig:
    """All settings of an embedding."""

    psnr_db: float = 47.0  # wanted PSNR of the mark in the worst view, against the unmarked render
    ssim: float = 0.998  # wanted SSIM of the mark in the worst view
    output: str = "fidelity"  # "fidelity" keeps each Gaussian's own residual, "compact" drops it
    compact_db: float = 40.0  # with "compact": least PSNR of the delivered model against the original, worst view
    views: int = 8  # key views at which the mark is shaped
    view_size: int = 800  # side of a key view, pixels
    # Views of the landmark bank by which the camera of a screenshot is found, fewer of flat ground; 0 leaves it out
    landmark_views: int = 48
    # Draws what is fitted, one of DEVICES: what pruning leaves, and what is refined. On a GPU it never comes out twice
    # the same
    device: str = "cpu"
    # Knobs of those stages
    quantize: HvqConfig = field(default_factory=HvqConfig)
    prune: PruneConfig = field(default_factory=PruneConfig)
    plan: PlanConfig = field(default_factory=PlanConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)

    def __post_init__(self) -> None:
        if self.output not in ("fidelity", "compact"):
            raise InputError(f"output must be 'fidelity' or 'compact', got {self.output!r}")
        if not 20.0 <= self.psnr_db <= 90.0:
            raise InputError(f"psnr must lie between 20 and 90 dB, got {self.psnr_db}")
        if self.prune.budget_db is not None and not 15.0 <= self.prune.budget_db <= 80.0:
            raise InputError(f"budget must lie between 15 and 80 dB or be 'none', got {self.prune.budget_db}")
        if self.device not in DEVICES:
            raise InputError(f"device must be one of {', '.join(DEVICES)}, got {self.device!r}")

    @property
    def keeps_rows(self) -> bool:
        """Whether the delivered model is the owner's own, Gaussian by Gaussian."""
        return self.output == "fidelity" and not self.thins

    @property
    def thins(self) -> bool:
        """Whether Gaussians are taken away, or split."""
        return self.prune.budget_db is not None or self.paper.tau_base > 0 or self.paper.densify > 0

    @property
    def recovers(self) -> bool:
        """Whether what is left is fitted, which decides what a mark refers to."""
        return self.thins and self.prune.recover

    def to_json(self) -> Json:
        """As a record holds it: what the paper does is named where it is done, recovery where rows go or codes are all
        that is left, and a GPU where one fitted."""
        plain = asdict(self)
        if self.device == "cpu":
            del plain["device"]
        if self.keeps_rows:
            del plain["prune"]["recover"]
        if self.paper == PaperConfig():
            del plain["paper"]
        return plain

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Self:
        """Of a record; what it does not name is as by default, but recovery, which earlier versions had not."""
        made: Self = _filled(cls(prune=PruneConfig(recover=False)), plain)
        return made


PAPER = EmbedConfig(
    # Of the mark alone (zeta scales a unit that the paper does not name): with pruning and codes some 30 dB are left in
    # the worst view, where its Table 6 prints 28.52, mean, against photographs
    psnr_db=31.0,
    ssim=0.975,
    output="compact",
    compact_db=0.0,  # as many residual stages as are named
    views=10,
    quantize=HvqConfig(residual_codes=(1024, 1024), lambda_freq=0.1),
    prune=PruneConfig(rank="paper", gamma=0.2),
    plan=PlanConfig(
        stages=3,
        residual_share=2.0 / 3.0,  # the message spread evenly over the stages
        texture_exponent=0.0,  # strength by uncertainty alone; texture counts in W^freq
        balance_rounds=0,
        mass_share=1.0,
        grain_center=0.0,
        grain_scale=0.0,
        surprise_exponent=0.0,
    ),
    refine=RefineConfig(steps=1000),  # the paper: 10,000, on a GPU
    paper=PaperConfig(
        tau_base=0.55, densify=0.05, frequency=True, tau_unc=1.0, public_codes=True, whole_sh=True, codes=1.0
    ),
)
"""The paper's system with the settings of its text."""


PROFILES: dict[str, EmbedConfig] = {
    "fast": EmbedConfig(views=6),
    "balanced": EmbedConfig(views=10),
    "strong": EmbedConfig(views=16, psnr_db=45.0, ssim=0.997),
    "paper": PAPER,
    "paper-appendix": replace(
        PAPER,
        paper=replace(PAPER.paper, tau_unc=1.1),
        refine=replace(PAPER.refine, lambda_msg=0.2, lambda_rec=0.5, lambda_wavelet=0.05),
    ),
}
"""fast and balanced differ in how many views shape the mark; strong spends 2 dB of fidelity on evidence. The other two
are the paper's, with the hyper-parameters of its text and of its appendix."""


AUTO = "auto"
"""The name under which a profile is left to the scene."""


SURVIVE = ("model", "pictures", "worst")
"""What `auto` plans for: the model and parts of it alone; one picture at JPEG quality 10 of the usual view; that and
noise of std 0.1, in the worst view."""


@dataclass(frozen=True)
class Auto:
    """Settings that a rehearsal on the scene chooses (`engine.flows.embed.auto_profile`)."""

    # Where to start from; its views, view size, landmarks and fidelity are chosen anew, and so is on what its pruning
    # budget is spent: no file need be larger than that allows
    start: EmbedConfig = PROFILES["fast"]
    survive: str = "pictures"  # what the claim must, one of SURVIVE
    kept: frozenset[str] = frozenset()  # knobs that the owner named, and that are not chosen
    format: str = "ply"  # of the delivered file, whose bytes count

    def __post_init__(self) -> None:
        if self.survive not in SURVIVE:
            raise InputError(f"survive must be one of {', '.join(SURVIVE)}, got {self.survive!r}")

    @property
    def unrehearsed(self) -> EmbedConfig:
        """The settings of what is not rehearsed, a scene that moves: of `balanced`, but for what the owner named.
        InputError where more than the default was to survive."""
        if self.survive != Auto.survive:
            raise InputError(f"a scene that moves is not rehearsed: survive={self.survive!r} cannot be kept")
        return self.start if "views" in self.kept else replace(self.start, views=PROFILES["balanced"].views)

    def as_earlier(self, earlier: EmbedConfig) -> "EmbedConfig | Auto":
        """The settings of an earlier copy, which copies share, unless the owner named others."""
        named = self.kept | ({"prune.budget_db"} if self.start.prune.budget_db is not None else set())
        alike = all(attrgetter(knob)(self.start) == attrgetter(knob)(earlier) for knob in named)
        return earlier if alike else self


Settings = EmbedConfig | Auto
"""The settings of an embedding, or how to choose them."""


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
    survive: str | None = None,
    device: str | None = None,
    knobs: Sequence[str] = (),
) -> Settings:
    """A named profile, or `auto`, with what an owner wants changed; None leaves the profile's own.

    `survive` is for `auto`, see SURVIVE. `device` is one of DEVICES: InputError where it is a GPU and there is none.
    `knobs` are texts like ``"quantize.cells=1024"``, any knob that `mark3dgs config show` lists.
    """
    wanted = {"psnr_db": psnr_db, "output": output}
    changes: Json = {knob: value for knob, value in wanted.items() if value is not None}
    config = replace(Auto().start, **changes) if name == AUTO else profile(name, **changes)
    if budget_db is not None:
        config = replace(config, prune=replace(config.prune, budget_db=budget_db))
    config = replace(config, device=device or config.device)
    for knob in knobs:
        config = _turned(config, *knob.partition("=")[::2])
    config = replace(config, device=find_device(config.device))
    if name != AUTO:
        if survive is not None:
            raise InputError(f"profile {name!r} chooses nothing: survive is for {AUTO!r}")
        return config
    named = {knob.partition("=")[0] for knob in knobs} | set(changes)
    return Auto(config, survive or "pictures", frozenset(named))


def _filled(config: Any, plain: Mapping[str, Any]) -> Any:
    """A configuration with the values of a plain one, stages within stages."""
    changes: Json = {}
    for each in fields(config):
        if each.name in plain:
            now, value = getattr(config, each.name), plain[each.name]
            if is_dataclass(now):
                value = _filled(now, value)
            changes[each.name] = tuple(value) if isinstance(now, tuple) else value
    return replace(config, **changes)


def delivered_as(settings: Settings | None, format: str) -> Settings | None:
    """The settings, knowing the format of the delivered file."""
    return replace(settings, format=format) if isinstance(settings, Auto) else settings


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
        if isinstance(now, bool):
            return {"true": True, "false": False}[text.lower()]
        if isinstance(now, tuple):
            return tuple(int(part) for part in text.split(",") if part not in ("", "-"))
        if knob == "prune.budget_db" and text == "none":
            return None
        return int(text) if isinstance(now, int) else float(text)
    except (ValueError, KeyError):
        raise InputError(f"{knob} is {now!r} and cannot be {text!r}") from None
