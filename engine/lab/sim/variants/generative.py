"""Generated models (DreamGaussian and its kin): a hook that marks at the end of generation, and a way to make one.

Tang, Ren, Zhou, Liu and Zeng, "DreamGaussian: Generative Gaussian Splatting for Efficient 3D Content Creation"
(ICLR 2024) optimizes a few thousand Gaussians of SH degree 0 from a random ball. Its PLY holds raw parameters, with
quaternions of any length; `engine.formats.read_model` reads that as it is.
"""

import functools
import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ParamSpec, TypeVar, cast, overload

import numpy as np

from engine.compress.hvq import HvqConfig
from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import EmbedConfig, profile
from engine.formats import encode_model, read_model
from engine.formats.file_writing import write_model, write_whole
from engine.formats.ply.gaussians import write_ply
from engine.model import Camera, Float32, GaussianModel
from engine.watermark.keys import OwnerKey

P = ParamSpec("P")
Generated = TypeVar("Generated", GaussianModel, str, Path)

BALL_RADIUS = 0.5  # of the ball of random points that DreamGaussian starts from, in radii of the object
BALL_POINTS = 5_000

FEW_GAUSSIANS = profile("balanced", psnr_db=44.0, ssim=0.9965, quantize=HvqConfig(min_members=1))
"""For a few thousand large Gaussians: cells of one or two, since there are no more to be had; 3 dB more mark than
usual, which is still far below what separates a generated model from what it was made after."""


@dataclass(frozen=True)
class Marking:
    """Marks what a generator returns; see `marking`."""

    key: OwnerKey
    records: str | os.PathLike[str]
    bits: int
    config: EmbedConfig

    @overload
    def __call__(self, target: Generated) -> Generated: ...
    @overload
    def __call__(self, target: Callable[P, Generated]) -> Callable[P, Generated]: ...

    def __call__(
        self, target: GaussianModel | str | Path | Callable[P, Generated]
    ) -> GaussianModel | str | Path | Callable[P, Generated]:
        """Mark a model or file, or wrap a function that returns one."""
        if isinstance(target, GaussianModel | str | Path):
            return self._mark(target)
        if not callable(target):
            raise InputError(f"a model, a path or a function is marked, got {type(target).__name__}")
        generate = target

        @functools.wraps(generate)
        def marked(*args: P.args, **kwargs: P.kwargs) -> Generated:
            return cast(Generated, self._mark(generate(*args, **kwargs)))  # the same type comes back

        return marked

    def _mark(self, result: GaussianModel | str | Path) -> GaussianModel | str | Path:
        if isinstance(result, GaussianModel):
            return self._embed(result, hashlib.sha256(encode_model(result, "ply")).hexdigest())
        if not isinstance(result, str | Path):
            raise InputError(f"the generator returned {type(result).__name__}, no model and no path")
        loaded = read_model(result)
        write_model(self._embed(loaded.model, loaded.sha256), result, loaded.format)
        return result

    def _embed(self, model: GaussianModel, digest: str) -> GaussianModel:
        """Mark, and put the record away before anything marked leaves."""
        result = embed(model, self.key, original_sha256=digest, bits=self.bits, config=self.config)
        folder = Path(self.records)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made: {error.strerror or error}") from None
        name = f"{result.record.header.record_id}.record"
        write_whole(folder / name, [result.record.to_bytes(self.key)])
        return result.model


def marking(
    key: OwnerKey, records: str | os.PathLike[str], *, bits: int = 32, config: EmbedConfig | None = None
) -> Marking:
    """A mark at the end of generation: nothing leaves the generator without one.

    It is a decorator for a generator that returns a GaussianModel or a path; or a callback, called with either. A
    path's file is replaced by the marked one, in its own format; its record is there before. The folder `records` gets
    one record for each generated model, named by its record id; the config is `FEW_GAUSSIANS` where not given.

    CapacityError on marking, if the model cannot carry the message. A file is left as the generator wrote it, so that
    nothing is lost; a generator that returns a model in memory may want to write it first.

    Examples
    --------
    >>> import tempfile
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from engine.model import GaussianModel
    >>> from engine.lab.sim.variants.generative import FEW_GAUSSIANS, marking
    >>> from engine.watermark.keys import OwnerKey
    >>> key = OwnerKey(bytes(range(32)))  # a real one comes from `mark3dgs keygen`
    >>> records = tempfile.mkdtemp()
    >>> quick = replace(FEW_GAUSSIANS, views=4, view_size=256, landmark_views=0)
    >>> @marking(key, records, bits=16, config=quick)
    ... def generate(seed):
    ...     rng = np.random.default_rng(seed)
    ...     ball = rng.standard_normal((2000, 3))
    ...     ball *= 0.5 / np.linalg.norm(ball, axis=1, keepdims=True)
    ...     quats = np.tile([1.0, 0, 0, 0], (2000, 1))
    ...     color = 0.5 * np.sin(6 * ball)[:, None]
    ...     return GaussianModel(ball, np.full((2000, 3), -3.5), quats, np.full(2000, 2.0), color)
    >>> marked = generate(seed=3)
    >>> len(marked)
    2000
    """
    return Marking(key, records, bits, config or FEW_GAUSSIANS)


def generate_from_views(
    cameras: Sequence[Camera],
    images: Sequence[Float32],
    *,
    points: int = BALL_POINTS,
    steps: int = 500,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> GaussianModel:
    """Optimize Gaussians from a random ball of `points`, as DreamGaussian does, towards given views of an object.

    The published system is guided by a diffusion model, which is not to be had here: renders of a real object, on black
    and from cameras around it, take its place. What comes out is like it in all that a mark meets: a few thousand large
    Gaussians without view-dependent color. Results must say that it was made so.
    """
    from engine.lab.sim.capture.capture_kernels import kernels_from_points
    from engine.lab.sim.capture.trainer import DensifyConfig, TrainConfig, train

    rng = np.random.default_rng(seed)
    eyes = np.stack([camera.position for camera in cameras])
    axes = np.stack([camera.viewmat[2, :3] for camera in cameras])
    # The point nearest to all optical axes, and the radius that fills their pictures.
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    center = np.linalg.solve(across.sum(axis=0), np.einsum("vij,vj->i", across, eyes))
    reach = np.linalg.norm(eyes - center, axis=1) * [0.5 * c.width / c.K[0, 0] for c in cameras]
    ball = rng.standard_normal((points, 3))
    ball *= BALL_RADIUS * reach.mean() * rng.random((points, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1)[:, None]
    start = kernels_from_points(center + ball, rng.random((points, 3)))
    config = TrainConfig(  # DreamGaussian's rates: 20 times INRIA's for the centers, since steps are few
        steps=steps,
        position_rate=1e-3,
        position_rate_end=2e-5,
        color_rate=0.01,
        sh_degree=0,
        seed=seed,
        densify=DensifyConfig(first=0.1, last=0.7, every=50, reset=1.0),
    )
    return train(start, cameras, images, config, advance)


def write_raw_ply(model: GaussianModel, *, seed: int = 0) -> Iterator[bytes]:
    """A PLY as generators write it: quaternions of the lengths their optimizer left them, here drawn from a seed."""
    lengths = np.random.default_rng(seed).lognormal(0.0, 0.4, (len(model), 1))
    return write_ply(model.with_(quats=(model.quats * lengths).astype(np.float32)))
