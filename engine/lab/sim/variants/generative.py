"""Generated models (DreamGaussian and its kin): a hook that marks at the end of generation, and a way to make one.

Tang, Ren, Zhou, Liu and Zeng, "DreamGaussian: Generative Gaussian Splatting for Efficient 3D Content Creation"
(ICLR 2024) optimizes a few thousand Gaussians of SH degree 0 from a random ball. Its PLY holds raw parameters, with
quaternions of any length; `engine.formats.read_model` reads that as it is.
"""

import functools
import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import ParamSpec, TypeVar

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


def mark_generated(
    result: Generated, key: OwnerKey, records: str | os.PathLike[str], *, bits: int = 32, config: EmbedConfig
) -> Generated:
    """What a generator returns, marked: a model, or the path of a file, which the marked one replaces in its format.

    The folder `records` gets its record, named by the record id, before anything marked leaves. CapacityError if the
    model cannot carry the message; a file is then left as the generator wrote it.
    """
    given: GaussianModel | str | Path = result
    if isinstance(given, GaussianModel):
        model, digest = given, hashlib.sha256(encode_model(given, "ply")).hexdigest()
    elif isinstance(given, str | Path):
        loaded = read_model(given)
        model, digest = loaded.model, loaded.sha256
    else:
        raise InputError(f"the generator returned {type(result).__name__}, no model and no path")
    made = embed(model, key, original_sha256=digest, bits=bits, config=config)
    folder = Path(records)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    write_whole(folder / f"{made.record.header.record_id}.record", [made.record.to_bytes(key)])
    if isinstance(given, GaussianModel):
        return made.model  # type: ignore[return-value]  # the same type comes back
    write_model(made.model, given, loaded.format)
    return result


def marking(
    key: OwnerKey, records: str | os.PathLike[str], *, bits: int = 32, config: EmbedConfig | None = None
) -> Callable[[Callable[P, Generated]], Callable[P, Generated]]:
    """A mark at the end of generation: a decorator after which nothing leaves a generator without one.

    See `mark_generated`; the config is `FEW_GAUSSIANS` where not given. A generator that returns a model in memory may
    want to write it first: what cannot be marked is lost.

    Examples
    --------
    >>> import tempfile
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from engine.model import GaussianModel
    >>> from engine.lab.sim.variants.generative import FEW_GAUSSIANS, marking
    >>> from engine.watermark.keys import OwnerKey
    >>> key = OwnerKey(bytes(range(32)))  # a real one comes from `mark3dgs keygen`
    >>> quick = replace(FEW_GAUSSIANS, views=4, view_size=256, landmark_views=0)
    >>> @marking(key, tempfile.mkdtemp(), bits=16, config=quick)
    ... def generate(seed):
    ...     rng = np.random.default_rng(seed)
    ...     ball = rng.standard_normal((2000, 3))
    ...     ball *= 0.5 / np.linalg.norm(ball, axis=1, keepdims=True)
    ...     quats = np.tile([1.0, 0, 0, 0], (2000, 1))
    ...     color = 0.5 * np.sin(6 * ball)[:, None]
    ...     return GaussianModel(ball, np.full((2000, 3), -3.5), quats, np.full(2000, 2.0), color)
    >>> len(generate(seed=3))
    2000
    """

    def mark(generate: Callable[P, Generated]) -> Callable[P, Generated]:
        @functools.wraps(generate)
        def marked(*args: P.args, **kwargs: P.kwargs) -> Generated:
            made = generate(*args, **kwargs)
            return mark_generated(made, key, records, bits=bits, config=config or FEW_GAUSSIANS)

        return marked

    return mark


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
