"""Choosing settings for a scene (`embed --profile auto`): the cheapest whose mark one bad picture still shows.

A scene is rehearsed: its mark is planned and its strength solved on a few small views, with random chips and no
landmarks. Then views that no key view was are rendered large, kept as bad JPEG files and read as suspects would be.
Under noise follows without rendering, from the mark's PSNR and the number of chips that matter,

    z = 1 / sqrt(1 / (NOISE_EFFICIENCY^2 S) + 1 / E),   S = 3 P 10^(-PSNR / 10) / NOISE^2,   P pixels, E chips.

The lower z is what the scene promises. The same functions serve `mark3dgs evaluate --suite pareto`, which holds every
promise against what was measured.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.numerics.image_metrics import psnr
from engine.pipeline.groundwork import Groundwork, lay_groundwork
from engine.pipeline.profiles import Auto, EmbedConfig
from engine.pipeline.rigs import make_rig
from engine.pipeline.scenes import look
from engine.pipeline.strength import add_dc, first_guess, solve_strength
from engine.watermark.image_evidence import gather_displacements
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.masses import spare_masses
from engine.watermark.planning import BIT_Z, make_plan
from engine.watermark.statistics import CHANCE_RATE, claim_z, z_threshold

__all__ = ["Choice", "Rehearsal", "choose", "rehearse", "wanted_z"]

PICTURE = 800
"""Side of the bad picture, pixels."""
QUALITY = 10
"""Of the JPEG it goes through."""
NOISE, NOISE_EFFICIENCY = 0.1, 0.46
"""Std of the noise in the other bad picture, range 1, and measured over ideal z under it: the lowest of four scenes at
44 to 53 dB (docs/RESULTS.md). Noise does not care what the picture shows, so it is not played."""
MARGIN = 1.15
"""Promised over needed z: with other chips z is one more or less, in other views a little, too."""
SLACK_DB = 2.0
"""By how much the mark may fall short of its PSNR in a view that no key view was near."""
VIEW_SIZE = 256
"""Key views of 256 pixels shape the same mark as those of 800: docs/RESULTS.md, pareto."""
VIEWS = (6, 10, 16)
LOWER_DB = (1.0, 2.0)
"""What may be taken off the fidelity where evidence is short; the last gives the fidelity of `strong`."""
SSIM_PER_DB = 0.0005
"""And off SSIM with it, as in `strong`."""
REHEARSAL_SEED = 0x5EED
HELD_OUT, WORST = 6, 2
"""Views that no key view was; the one that shows least of the mark decides. At another fidelity only those are read
that showed least before."""


@dataclass(frozen=True)
class Rehearsal:
    """What a scene promises under some settings."""

    # Of the claim from one bad picture of an unseen view: at JPEG quality 10, the worst of several, or under noise of
    # std 0.1, whichever is lower
    predicted_z: float
    psnr_db: float  # of the mark, worst key view; above the one asked for where SSIM limits
    held_out_db: float  # of the mark, worst of some views that are not key views


@dataclass(frozen=True)
class Choice:
    """The settings chosen for a scene."""

    config: EmbedConfig
    rehearsal: Rehearsal  # of these settings
    wanted_z: float
    # Whether one bad picture is predicted to show all bits and a claim. Where nothing meets that, the choice is the
    # strongest; better pictures, several, or the model itself may still show everything.
    met: bool
    tried: int  # settings rehearsed
    ground: Groundwork  # what was rehearsed on; `embed` goes on from it

    def report(self) -> dict[str, float | int | bool]:
        """Plain values for `embed --json`."""
        return {
            "views": self.config.views,
            "view_size": self.config.view_size,
            "psnr_db": self.config.psnr_db,
            "predicted_z": self.rehearsal.predicted_z,
            "predicted_psnr_db": self.rehearsal.psnr_db,
            "predicted_held_out_db": self.rehearsal.held_out_db,
            "wanted_z": self.wanted_z,
            "met": self.met,
            "tried": self.tried,
        }


def wanted_z(bits: int) -> float:
    """z that a picture must be predicted to give: a claim at 1e-9 and every bit clear, with MARGIN.

    A bit's z is the message's over the root of its length; BIT_Z of them is what the planner accepts.
    """
    return MARGIN * max(z_threshold(CHANCE_RATE), (BIT_Z + 0.2) * math.sqrt(bits))


@one_blas_thread
def choose(
    model: GaussianModel,
    key: OwnerKey,
    bits: int,
    asked: Auto,
    original_sha256: str,
    cameras: Sequence[Camera] | None = None,
) -> Choice:
    """The cheapest settings that are predicted to do: the fewest views that do, then the highest fidelity that does.

    Deterministic. InputError if no copy of the model could be registered.

    Parameters
    ----------
    key : OwnerKey
        Draws the key views, on which the mark is rehearsed as it will be made; its chips are not looked at.
    asked : Auto
        The number of cells is not chosen: fewer save no time, more show no better.
    original_sha256 : str
        Hex digest of the owner's file.
    cameras : sequence of Camera, optional
        The owner's own.
    """
    wanted, tried = wanted_z(bits), 0
    for views in VIEWS:
        tried += 1
        config = replace(asked.start, views=views, view_size=VIEW_SIZE)
        scene = _Rehearsing(lay_groundwork(model, key, original_sha256, config, cameras), cameras)
        found = scene.at(config)
        if found.held_out_db >= config.psnr_db - SLACK_DB:
            break
    if found.predicted_z < wanted and not asked.keep_psnr:
        faithful = config
        for lower in LOWER_DB:
            config = _lowered(faithful, lower)
            found, tried = scene.at(config), tried + 1
            if found.predicted_z >= wanted:
                break
    return Choice(config, found, wanted, found.predicted_z >= wanted, tried, scene.ground)


def rehearse(model: GaussianModel, key: OwnerKey, config: EmbedConfig, original_sha256: str) -> Rehearsal:
    """What a mark on the unpruned model promises, planned on small views of the key, with chips from a fixed seed."""
    small = replace(config, view_size=VIEW_SIZE)
    return _Rehearsing(lay_groundwork(model, key, original_sha256, small), None).at(small)


def _lowered(config: EmbedConfig, by: float) -> EmbedConfig:
    """Less fidelity, more evidence."""
    return replace(config, psnr_db=max(config.psnr_db - by, 20.0), ssim=config.ssim - SSIM_PER_DB * by)


class _Rehearsing:
    """A scene with a mark planned on its key views, whose strength is still open."""

    def __init__(self, ground: Groundwork, cameras: Sequence[Camera] | None) -> None:
        self.ground = ground
        model, config = ground.model, ground.config
        rng = np.random.default_rng(REHEARSAL_SEED)
        self._unseen = look(model, self._unseen_cameras(cameras, rng), lambda fraction: None)
        self._telling = list(range(len(self._unseen.views)))  # which of them are read
        stages, emphasis = spare_masses(model.sh[:, 0], ground.stages, config.plan.mass_share)
        self._plan = make_plan(stages, ground.impact, config.plan, emphasis)
        layout = self._plan.layout
        self._signs = rng.choice((-1.0, 1.0), layout.chips).astype(np.int8)
        self._displacement = layout.displace(layout.amplitudes * self._signs)

    def _unseen_cameras(self, cameras: Sequence[Camera] | None, rng: np.random.Generator) -> list[Camera]:
        """Views that are no key views, at the size of the bad picture: of the owner's cameras where some are left."""
        taken = {camera.viewmat.tobytes() for camera in self.ground.cameras}
        left = [camera for camera in cameras or () if camera.viewmat.tobytes() not in taken]
        if left:
            spread = np.linspace(0, len(left) - 1, min(HELD_OUT, len(left))).round().astype(int)
            return [left[i].with_side(PICTURE) for i in spread]
        jitter = rng.random((HELD_OUT, 4))
        extent = self.ground.extent
        return make_rig(self.ground.model, HELD_OUT, PICTURE, PICTURE, jitter=jitter, extent=extent)

    def at(self, config: EmbedConfig) -> Rehearsal:
        """What these settings' fidelity promises."""
        ground, energies = self.ground, self._plan.energies  # (V, C)
        totals = energies.sum(axis=1)
        start = first_guess(energies, ground.cameras, config.psnr_db)
        strength = solve_strength(ground.views, self._displacement, config.psnr_db, config.ssim, start)
        layout = self._plan.times(strength.factor).layout
        marked = add_dc(ground.model.sh, np.float32(strength.factor) * self._displacement)
        pictures = [self._unseen.render(k, marked) for k in range(len(self._unseen.views))]
        held_out_db = min(psnr(a, b) for a, b in zip(self._unseen.images, pictures, strict=True))
        with ThreadPoolExecutor() as pool:  # most of it is NumPy on one thread
            read = list(pool.map(lambda k: self._read(pictures[k], k, layout), self._telling))
        found = sorted(zip(read, self._telling, strict=True))
        self._telling = [k for _, k in found[:WORST]]
        chips = float((totals**2 / np.maximum((energies**2).sum(axis=1), 1e-300)).min())  # that matter
        signal = 3.0 * PICTURE**2 * 10 ** (-strength.psnr_db / 10.0) / NOISE**2
        noisy = 1.0 / math.sqrt(1.0 / max(NOISE_EFFICIENCY**2 * signal, 1e-12) + 1.0 / max(chips, 1e-12))
        return Rehearsal(min(found[0][0], noisy), strength.psnr_db, held_out_db)

    def _read(self, picture: Float32, number: int, layout: Layout) -> float:
        """z of the claim from an unseen view of the marked model, kept badly."""
        plain, marked = (np.clip(image, 0.0, 1.0) for image in (self._unseen.images[number], picture))
        y = gather_displacements(layout, self._unseen.views[number], plain, _spoil(marked), QUALITY)
        one_bit = np.zeros(layout.chips, dtype=np.int32)
        return claim_z(y, layout.amplitudes, one_bit, self._signs, np.ones(1, dtype=np.int8))


def _spoil(picture: Float32) -> Float32:
    """The picture after JPEG."""
    import cv2

    stored = np.round(picture[..., ::-1] * 255.0).astype(np.uint8)
    coded = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    decoded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.float32)
    return decoded[..., ::-1] / np.float32(255.0)
