"""Adaptive density control (Kerbl et al. 2023, section 5.2): where training adds Gaussians and takes them away."""

from dataclasses import dataclass

import numpy as np

from engine.errors import InputError
from engine.lab.sim.capture.parameters import Parameters
from engine.lab.sim.model_placement import join
from engine.model import Float32, GaussianModel, Int32
from engine.numerics.similarity import quaternion_to_rotation

__all__ = ["CenterGradients", "DensifyConfig", "densify"]

_SPLIT_SHRINK = 1.6  # a split Gaussian's two parts are this much smaller (INRIA: 0.8 times the number of parts)

RESET_OPACITY = 0.01


@dataclass(frozen=True)
class DensifyConfig:
    """Knobs of the density control; at 30,000 steps the defaults are INRIA's."""

    first: float = 500 / 30_000  # when it begins, part of the training: step 500 of 30,000
    last: float = 0.5  # when it ends: step 15,000
    every: int = 100  # steps between two rounds
    # Gaussians whose centre is pulled more strongly than this across the image are cloned or split: mean over the views
    # of the norm of dL/d(centre), in half images
    gradient: float = 2e-4
    # larger ones are split, smaller ones cloned; largest standard deviation, part of the extent of the cameras
    split_size: float = 0.01
    min_opacity: float = 0.005  # fainter ones are removed
    # larger ones are removed after the first opacity reset, part of the extent. INRIA's bound in pixels is left out, as
    # gsplat leaves it out: it depends on the size of the photos
    max_size: float = 0.1
    reset: float = 0.1  # opacities are brought down to 0.01 so often, part of the training: every 3,000 steps of 30,000
    most: int = 1_000_000  # no more Gaussians than this: those pulled most come first

    def __post_init__(self) -> None:
        if not 0.0 <= self.first <= self.last <= 1.0:
            raise InputError(f"need 0 <= first <= last <= 1, got {self.first} and {self.last}")
        if self.every < 1 or self.most < 1:
            raise InputError(f"every and most must be at least 1, got {self.every} and {self.most}")
        if not 0.0 < self.reset <= 1.0:
            raise InputError(f"reset is {self.reset}, expected a part of the training in (0, 1]")
        sizes = (self.gradient, self.split_size, self.max_size)
        if min(sizes) <= 0.0 or not 0.0 <= self.min_opacity < RESET_OPACITY:
            raise InputError(
                f"gradient, split_size and max_size must be positive and min_opacity below {RESET_OPACITY}, got "
                f"{', '.join(f'{v:g}' for v in sizes)} and {self.min_opacity:g}"
            )


class CenterGradients:
    """Mean pull on every centre across the image, over the views that saw the Gaussian."""

    def __init__(self, count: int) -> None:
        self.sums = np.zeros(count, dtype=np.float64)
        self.views = np.zeros(count, dtype=np.int32)

    def add(self, centers: Float32, visible: Int32, width: int, height: int) -> None:
        """One view: centers (2, N) is dL/d(projected centre) in pixels, `visible` who was seen."""
        x, y = centers[0, visible] * (0.5 * width), centers[1, visible] * (0.5 * height)
        self.sums[visible] += np.hypot(x, y)
        self.views[visible] += 1

    @property
    def mean(self) -> Float32:
        """(N,) mean norm, in half images; 0 for those that no view saw."""
        return (self.sums / np.maximum(self.views, 1)).astype(np.float32)


def densify(
    parameters: Parameters,
    pull: Float32,
    extent: float,
    config: DensifyConfig,
    rng: np.random.Generator,
    *,
    prune_large: bool,
) -> None:
    """One round, in place: clone and split where the centres are pulled, remove what is faint or too large.

    `pull` (N,) is `CenterGradients.mean`, `extent` that of the cameras (scene units); `rng` places the parts of split
    Gaussians, and with `prune_large` those beyond `max_size` go.
    """
    model = parameters.model
    sizes = model.log_scales.max(axis=1)
    pulled = pull > config.gradient
    room = max(config.most - len(model), 0)  # each adds one Gaussian: the strongest come first
    pulled[np.argsort(-pull, kind="stable")[room:]] = False
    large = sizes > np.log(config.split_size * extent)
    cloned, split = np.flatnonzero(pulled & ~large), np.flatnonzero(pulled & large)
    faint = model.opacities < config.min_opacity
    gone = faint | (sizes > np.log(config.max_size * extent)) if prune_large else faint
    kept = ~gone
    kept[split] = False
    new = join(model.take(cloned[~gone[cloned]]), _parts(model.take(split[~faint[split]]), rng))
    if prune_large:
        new = new.take(new.log_scales.max(axis=1) <= np.log(config.max_size * extent))
    if kept.any() or len(new):
        parameters.regroup(np.flatnonzero(kept), new)


def _parts(model: GaussianModel, rng: np.random.Generator) -> GaussianModel:
    """Two smaller Gaussians for each, at places drawn from it."""
    twice = model.take(np.repeat(np.arange(len(model)), 2))
    steps = rng.standard_normal((len(twice), 3)) * twice.scales  # (2 n, 3), along their own axes
    lengths = np.maximum(np.linalg.norm(twice.quats, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    turns = quaternion_to_rotation(twice.quats / lengths).reshape(-1, 3, 3)
    return twice.with_(
        means=twice.means + np.einsum("nij,nj->ni", turns, steps).astype(np.float32),
        log_scales=twice.log_scales - np.float32(np.log(_SPLIT_SHRINK)),
    )
