"""Training Gaussians on photos with the CPU rasterizer (Kerbl et al. 2023): Adam on L1 and D-SSIM, densification.

A step: 1. a photo in random order, 2. render, 3. loss and its gradient, 4. gradients of all parameters, 5. Adam,
6. now and then: densify and prune (their section 5.2), bring opacities down, one more SH degree.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.raster.sh_gradients import sh_colors_backward
from engine.lab.sim.capture.photo_loss import photo_loss
from engine.lab.sim.model_placement import join
from engine.model import Camera, Float32, GaussianModel, Int32
from engine.numerics.adam import AdamMoments, adam_step
from engine.numerics.similarity import quaternion_to_rotation
from engine.raster import Gradients, View, backward, draw, prepare_view, sh_colors

SH_REST = 20.0  # higher SH bands move so much slower than DC (INRIA)

NAMES = ("means", "log_scales", "quats", "opacity_logits", "sh")


class Parameters:
    """All parameters of a model under training; copies, so that the model given stays as it is."""

    def __init__(self, model: GaussianModel) -> None:
        self.arrays: dict[str, Float32] = {name: getattr(model, name).copy() for name in NAMES}
        self.moments = {name: AdamMoments.zeros(array) for name, array in self.arrays.items()}

    def __len__(self) -> int:
        return len(self.arrays["means"])

    @property
    def model(self) -> GaussianModel:
        """The parameters as they are now: a view, which the next step changes."""
        a = self.arrays
        return GaussianModel(a["means"], a["log_scales"], a["quats"], a["opacity_logits"], a["sh"])

    def finished(self) -> GaussianModel:
        """A model of its own, with unit quaternions."""
        model = self.model.take(np.arange(len(self)))
        lengths = np.linalg.norm(model.quats, axis=1, keepdims=True)
        return model.with_(quats=model.quats / np.maximum(lengths, np.finfo(np.float32).tiny))

    def step(self, gradients: Gradients, rates: dict[str, float], number: int) -> None:
        """One Adam step of every parameter that has a rate; see `SH_REST`."""
        for name, rate in rates.items():
            rest = rate / SH_REST if name == "sh" else None
            adam_step(self.arrays[name], getattr(gradients, name), self.moments[name], rate, number, rate_rest=rest)

    def regroup(self, kept: npt.NDArray[np.int64], new: GaussianModel) -> None:
        """The Gaussians at `kept` with their moments, then the new ones, which start without any."""
        for name in NAMES:
            fresh: Float32 = getattr(new, name)
            self.arrays[name] = np.concatenate([self.arrays[name][kept], fresh])
            old, empty = self.moments[name], np.zeros_like(fresh)
            self.moments[name] = AdamMoments(*(np.concatenate([m[kept], empty]) for m in (old.first, old.second)))

    def raise_degree(self, coefficients: int) -> None:
        """More SH coefficients a channel; the new ones are 0 and have no moments."""
        missing = coefficients - self.arrays["sh"].shape[1]

        def grown(array: Float32) -> Float32:
            return np.concatenate([array, np.zeros((len(array), missing, 3), np.float32)], axis=1)

        old = self.moments["sh"]
        self.arrays["sh"] = grown(self.arrays["sh"])
        self.moments["sh"] = AdamMoments(grown(old.first), grown(old.second))

    def cap_opacity(self, opacity: float) -> None:
        """No Gaussian more opaque than this, and no moments left of it."""
        logit = np.float32(np.log(opacity / (1.0 - opacity)))
        logits = self.arrays["opacity_logits"]
        np.minimum(logits, logit, out=logits)
        self.moments["opacity_logits"] = AdamMoments.zeros(logits)


_SPLIT_SHRINK = 1.6  # a split Gaussian's two parts are this much smaller (INRIA: 0.8 times the number of parts)

RESET_OPACITY = 0.01


@dataclass(frozen=True)
class DensifyConfig:
    """Knobs of the density control; at 30,000 steps the defaults are INRIA's."""

    first: float = 500 / 30_000  # when it begins, part of the training: step 500 of 30,000
    last: float = 0.5  # when it ends: step 15,000
    every: int = 100  # steps between two rounds
    # Gaussians whose center is pulled more strongly than this across the image are cloned or split: mean over the views
    # of the norm of dL/d(center), in half images
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
    """Mean pull on every center across the image, over the views that saw the Gaussian."""

    def __init__(self, count: int) -> None:
        self.sums = np.zeros(count, dtype=np.float64)
        self.views = np.zeros(count, dtype=np.int32)

    def add(self, centers: Float32, visible: Int32, width: int, height: int) -> None:
        """One view: centers (2, N) is dL/d(projected center) in pixels, `visible` who was seen."""
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
    """One round, in place: clone and split where the centers are pulled, remove what is faint or too large.

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


MARGIN = 1.1  # extent of the cameras over the largest distance from their middle (INRIA)


@dataclass(frozen=True)
class TrainConfig:
    """Knobs of a training; rates are Adam steps, and the defaults INRIA's at 30,000 steps."""

    steps: int = 30_000  # one photo each
    # every parameter, or SH alone with the geometry frozen (then nothing is densified)
    trained: Literal["all", "colors"] = "all"
    position_rate: float = 1.6e-4  # of the centers at the first step, part of the extent of the cameras
    position_rate_end: float = 1.6e-6  # at the last step; exponential between
    scale_rate: float = 0.005  # of log-scales
    rotation_rate: float = 0.001  # of quaternions
    opacity_rate: float = 0.05  # of opacity logits
    color_rate: float = 0.0025  # of DC; higher SH bands move at a twentieth of it
    ssim_weight: float = 0.2  # of D-SSIM in the loss, 0 to 1; the rest is L1
    # degree reached in the end, 0 to 3; one more every `sh_every`. None: the model's own, from the start
    sh_degree: int | None = 3
    sh_every: float = 1_000 / 30_000  # part of the training after which the next SH degree joins: 1,000 steps of 30,000
    # color behind the Gaussians; "random" draws one for each step, so that nothing may hide in it
    background: float | tuple[float, float, float] | Literal["random"] = 0.0
    densify: DensifyConfig | None = field(default_factory=DensifyConfig)  # None: the number of Gaussians stays
    seed: int = 0  # of the photos' order, random backgrounds and places of split Gaussians

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise InputError(f"steps is {self.steps}, expected at least 1")
        if self.trained not in ("all", "colors"):
            raise InputError(f"trained must be 'all' or 'colors', got {self.trained!r}")
        if self.sh_degree is not None and self.sh_degree not in (0, 1, 2, 3):
            raise InputError(f"sh_degree is {self.sh_degree}, expected 0 to 3")
        shape = self.position_rate, self.position_rate_end, self.scale_rate, self.rotation_rate
        rates = (*shape, self.opacity_rate, self.color_rate, self.sh_every)
        if not all(np.isfinite(rate) and rate > 0.0 for rate in rates):
            raise InputError(f"rates must be positive, got {', '.join(f'{rate:g}' for rate in rates)}")
        if isinstance(self.background, str) and self.background != "random":
            raise InputError(f"background must be a color or 'random', got {self.background!r}")


def cameras_extent(cameras: Sequence[Camera]) -> float:
    """1.1 times the largest distance of a camera from the middle of all, scene units: INRIA's scale of a scene.

    Cameras at one place have none, and then it is the unit of the scene.
    """
    positions = np.stack([camera.position for camera in cameras])  # (V, 3)
    largest = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return MARGIN * largest if largest > 0.0 else 1.0


class Trainer:
    """A training in progress: can be stepped, looked at, and (being plain arrays) pickled and gone on with.

    It starts from a model, which is left as it is; `images` (H, W, 3) are what the cameras should see, 0 to 1.
    """

    def __init__(
        self,
        model: GaussianModel,
        cameras: Sequence[Camera],
        images: Sequence[Float32],
        config: TrainConfig | None = None,
    ) -> None:
        if len(cameras) != len(images) or not cameras:
            raise InputError(f"{len(cameras)} cameras for {len(images)} pictures")
        if len(model) == 0:
            raise InputError("the model to train is empty")
        for k, (camera, image) in enumerate(zip(cameras, images, strict=True)):
            if image.shape != (camera.height, camera.width, 3):
                raise InputError(f"picture {k} has shape {image.shape}, its camera {(camera.height, camera.width, 3)}")
        self.config = config or TrainConfig()
        self.cameras = list(cameras)
        self.images = [np.ascontiguousarray(image, dtype=np.float32) for image in images]
        self.extent = cameras_extent(cameras)
        self.parameters = Parameters(model)
        self.done = 0
        self._rng = np.random.default_rng(self.config.seed)
        self._queue: list[int] = []
        self._pull = CenterGradients(len(model))
        self._gradients = Gradients.empty(model)
        self._frozen: dict[int, View] = {}

    def step(self) -> float:
        """One step; returns the loss of the photo it saw."""
        config = self.config
        if not self._queue:
            self._queue = [int(k) for k in self._rng.permutation(len(self.cameras))]
        k = self._queue.pop()
        behind = self._rng.uniform(size=3) if config.background == "random" else config.background
        self.done += 1
        if config.trained == "colors":
            return self._step_colors(k, behind)
        return self._step_all(k, behind)

    def _step_all(self, k: int, behind: object) -> float:
        rendering = draw(self.parameters.model, self.cameras[k], np.asarray(behind, dtype=np.float32))
        loss, cotangent = photo_loss(rendering.image, self.images[k], self.config.ssim_weight)
        gradients = backward(rendering, cotangent, out=self._gradients)
        if self._densifying:
            camera = self.cameras[k]
            self._pull.add(gradients.centers, rendering.view.visible, camera.width, camera.height)
        self.parameters.step(gradients, self._rates(), self.done)
        self._control()
        return loss

    def _step_colors(self, k: int, behind: object) -> float:
        """The geometry stands still: one prepared view for each camera."""
        if k not in self._frozen:
            self._frozen[k] = prepare_view(self.parameters.model, self.cameras[k])
        arrays, position = self.parameters.arrays, self.cameras[k].position
        colors = sh_colors(arrays["sh"], arrays["means"], position)
        image, _ = self._frozen[k].render(colors, np.asarray(behind, dtype=np.float32))
        loss, cotangent = photo_loss(image, self.images[k], self.config.ssim_weight)
        toward = self._frozen[k].backward_colors(cotangent)
        sh_colors_backward(toward, arrays["sh"], arrays["means"], position, colors=colors, out=self._gradients.sh)
        self.parameters.step(self._gradients, {"sh": self.config.color_rate}, self.done)
        self._grow_degree()
        return loss

    def _rates(self) -> dict[str, float]:
        c = self.config
        part = (self.done - 1) / max(c.steps - 1, 1)
        position = c.position_rate * (c.position_rate_end / c.position_rate) ** min(part, 1.0)
        return {
            "means": position * self.extent,
            "log_scales": c.scale_rate,
            "quats": c.rotation_rate,
            "opacity_logits": c.opacity_rate,
            "sh": c.color_rate,
        }

    @property
    def _densifying(self) -> bool:
        density = self.config.densify
        return density is not None and self.done <= density.last * self.config.steps

    def _control(self) -> None:
        """Density, opacity and SH degree, where their step has come."""
        density = self.config.densify
        if density is not None and self._densifying:
            reset = max(1, round(density.reset * self.config.steps))
            if self.done > density.first * self.config.steps and self.done % density.every == 0:
                large = self.done > reset
                densify(self.parameters, self._pull.mean, self.extent, density, self._rng, prune_large=large)
                self._pull = CenterGradients(len(self.parameters))
                self._gradients = Gradients.empty(self.parameters.model)
            if self.done % reset == 0 and self.done < density.last * self.config.steps:
                self.parameters.cap_opacity(RESET_OPACITY)
        self._grow_degree()

    def _grow_degree(self) -> None:
        wanted, model = self.config.sh_degree, self.parameters.model
        every = max(1, round(self.config.sh_every * self.config.steps))
        if wanted is not None and model.sh_degree < wanted and self.done % every == 0:
            self.parameters.raise_degree((model.sh_degree + 2) ** 2)
            self._gradients = Gradients.empty(self.parameters.model)

    def run(self, advance: Callable[[float], None] | None = None, until: int | None = None) -> GaussianModel:
        """Step to the end (or to step `until`), telling `advance` the part done; returns the model as it is then."""
        last = self.config.steps if until is None else min(until, self.config.steps)
        while self.done < last:
            self.step()
            if advance:
                advance(self.done / self.config.steps)
        return self.parameters.finished()


def train(
    model: GaussianModel,
    cameras: Sequence[Camera],
    images: Sequence[Float32],
    config: TrainConfig | None = None,
    advance: Callable[[float], None] | None = None,
) -> GaussianModel:
    """Train a model, as from `kernels_from_points`, on photos: a whole `Trainer` run.

    The same input and seed give the same bytes.
    """
    return Trainer(model, cameras, images, config).run(advance)
