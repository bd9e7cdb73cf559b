"""Choosing settings for a scene (`embed --profile auto`): the cheapest whose mark one bad picture still shows.

A scene is rehearsed: its mark is planned and read from bad pictures before it is made. Its strength is solved on the
key views, with random chips and no landmarks. Then views that no key view was are rendered large, kept as bad JPEG
files and read as suspects would be. Under noise follows without rendering, from the mark's PSNR and the number of chips
that matter,

    z = 1 / sqrt(1 / (efficiency^2 S) + 1 / E),   S = 3 P 10^(-PSNR / 10) / noise^2,   P pixels, E chips.

The lower z is what the scene promises. Where the owner allows a loss (a pruning budget), every way of spending it
(`ways`) is rehearsed, too, smallest file first. The same functions serve `mark3dgs evaluate --suite
pareto`, which holds every promise against what was measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.flows.embed.config import CONFIG
from engine.flows.embed.delivery import Delivery, deliver
from engine.flows.embed.layer_strengths import add_dc, first_guess, solve_strength
from engine.flows.embed.planning_basis import Groundwork, lay_groundwork
from engine.flows.embed.profiles import Auto, EmbedConfig
from engine.flows.progress import Clock
from engine.flows.views.view_set import look
from engine.formats import encode_model
from engine.kernels.jit import side_by_side
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.numerics.image_metrics import psnr
from engine.watermark.config import CONFIG as WATERMARK
from engine.watermark.image_evidence import gather_displacements
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.masses import find_masses
from engine.watermark.planning import make_plan
from engine.watermark.statistics import CHANCE_RATE, claim_z, z_threshold

__all__ = ["Choice", "Rehearsal", "Rehearsing", "choose", "wanted_z", "ways"]

_CONFIG, _REHEARSAL = CONFIG.auto, CONFIG.rehearsal
REHEARSAL_SEED = 0x5EED


@dataclass(frozen=True)
class Rehearsal:
    """What a scene promises under some settings."""

    # Of the claim from one bad picture of an unseen view: at JPEG quality 10, the worst of several, or under noise of
    # std 0.1, whichever is lower
    predicted_z: float
    psnr_db: float  # of the mark, worst key view; above the wanted one where SSIM limits
    held_out_db: float  # of the mark, worst of some views that are not key views


class Rehearsing:
    """A scene with a mark planned on its key views, whose strength is still open."""

    def __init__(self, delivery: Delivery) -> None:
        self.delivery = delivery
        model, ground, config = delivery.model, delivery.ground, delivery.settings
        rng = np.random.default_rng(REHEARSAL_SEED)
        self._unseen = look(model, ground.unseen(_REHEARSAL.held_out, _REHEARSAL.side, rng), lambda fraction: None)
        self._telling = list(range(len(self._unseen.views)))  # which of them are read
        moving = None
        if config.output == "fidelity":
            moving = (~find_masses(model.sh[:, 0], config.plan.mass_share)).astype(np.float32)
        self._plan = make_plan(delivery.stages, ground.impact, config.plan, multiples=moving)
        layout = self._plan.layout
        self._signs = rng.choice((-1.0, 1.0), layout.chips).astype(np.int8)
        self._displacement = layout.displace(layout.amplitudes * self._signs)

    def at(self, config: EmbedConfig) -> Rehearsal:
        """What these settings' fidelity promises."""
        delivery, energies = self.delivery, self._plan.energies  # (V, C)
        totals = energies.sum(axis=1)
        # What the grain may take of the fidelity is not the tint's, which alone a bad picture shows.
        grained = config.plan.grain_center > 0 or config.plan.grain_scale > 0
        rest = 1.0 - CONFIG.strength.grain_ssim_share if grained else 1.0
        room_db = -10.0 * math.log10(rest)
        start = first_guess(energies, delivery.views.cameras, config.psnr_db + room_db)
        wanted = config.psnr_db + room_db, 1.0 - rest * (1.0 - config.ssim)
        strength = solve_strength(delivery.views, self._displacement, *wanted, start)
        layout = self._plan.times(strength.factor).layout
        marked = add_dc(delivery.model.sh, np.float32(strength.factor) * self._displacement)
        pictures = [self._unseen.render(k, marked) for k in range(len(self._unseen.views))]
        held_out_db = min(psnr(a, b) for a, b in zip(self._unseen.images, pictures, strict=True))
        # Most of it is NumPy on one thread.
        read = side_by_side(lambda k: self._read(pictures[k], k, layout), self._telling)
        found = sorted(zip(read, self._telling, strict=True))
        self._telling = [k for _, k in found[: _REHEARSAL.worst]]
        chips = float((totals**2 / np.maximum((energies**2).sum(axis=1), 1e-300)).min())  # that matter
        signal = 3.0 * _REHEARSAL.side**2 * 10 ** (-strength.psnr_db / 10.0) / _REHEARSAL.noise**2
        noisy = 1.0 / math.sqrt(1.0 / max(_REHEARSAL.noise_efficiency**2 * signal, 1e-12) + 1.0 / max(chips, 1e-12))
        return Rehearsal(min(found[0][0], noisy), strength.psnr_db - room_db, held_out_db - room_db)

    def _read(self, picture: Float32, number: int, layout: Layout) -> float:
        """z of the claim from an unseen view of the marked model, kept badly."""
        plain, marked = (np.clip(image, 0.0, 1.0) for image in (self._unseen.images[number], picture))
        y = gather_displacements(layout, self._unseen.views[number], plain, _spoil(marked), _REHEARSAL.quality)
        one_bit = np.zeros(layout.chips, dtype=np.int32)
        return claim_z(y, layout.amplitudes, one_bit, self._signs, np.ones(1, dtype=np.int8))


def _spoil(picture: Float32) -> Float32:
    """The picture after JPEG."""
    import cv2

    stored = np.round(picture[..., ::-1] * 255.0).astype(np.uint8)
    coded = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, _REHEARSAL.quality])[1]
    decoded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.float32)
    return decoded[..., ::-1] / np.float32(255.0)


def ways(config: EmbedConfig, allowed_db: float, sh_degree: int) -> Iterator[EmbedConfig]:
    """Settings that spend an allowance on a model of this degree: pruned as it is, or cut to fewer harmonics first."""
    for degree in range(sh_degree + 1):
        yield replace(config, prune=replace(config.prune, budget_db=allowed_db, sh_degree=degree))


@dataclass(frozen=True)
class Way:
    """One way of spending an allowance, and what it leaves."""

    sh_degree: int
    gaussians: int
    bytes: int  # of the delivered file, before its mark
    predicted_z: float | None  # None where a smaller file did, and this one was not rehearsed


@dataclass(frozen=True)
class Spent:
    """On what an owner's allowance went."""

    allowed_db: float
    sh_degree: int | None  # of the way taken; None where none leaves enough of the mark: the model is kept whole
    bytes_whole: int  # of the delivered file if nothing were spent
    ways: tuple[Way, ...]  # smallest file first


@dataclass(frozen=True)
class Choice:
    """The settings chosen for a scene."""

    rehearsal: Rehearsal  # of these settings
    wanted_z: float
    tried: int  # settings rehearsed
    ground: Groundwork  # of the model as it came
    delivery: Delivery  # what was rehearsed on; `embed` goes on from it
    spent: Spent | None  # on what the owner's allowance went, where there was one

    @property
    def config(self) -> EmbedConfig:
        """The settings."""
        return self.delivery.settings

    @property
    def met(self) -> bool:
        """Whether one bad picture is predicted to show all bits and a claim.

        Where nothing meets that, the choice is the strongest; better pictures, several, or the model itself may still
        show everything.
        """
        return self.rehearsal.predicted_z >= self.wanted_z

    def report(self) -> ChoiceReport:
        """The choice in plain values."""
        config, found = self.config, self.rehearsal
        return ChoiceReport(
            views=config.views,
            view_size=config.view_size,
            psnr_db=config.psnr_db,
            predicted_z=found.predicted_z,
            predicted_psnr_db=found.psnr_db,
            predicted_held_out_db=found.held_out_db,
            wanted_z=self.wanted_z,
            met=self.met,
            tried=self.tried,
            spent=self.spent,
        )


@dataclass(frozen=True)
class ChoiceReport:
    """A choice as `embed --json` tells it: settings, what they promise of one bad picture, and what was wanted."""

    views: int
    view_size: int  # pixels
    psnr_db: float
    predicted_z: float
    predicted_psnr_db: float
    predicted_held_out_db: float  # dB, in views that were not looked at
    wanted_z: float
    met: bool
    tried: int  # settings rehearsed
    spent: Spent | None


def wanted_z(bits: int) -> float:
    """z that a picture must be predicted to give: a claim at 1e-9 and every bit clear, with a `margin`.

    A bit's z is the message's over the root of its length; `bit_z` of them is what the planner accepts.
    """
    return _CONFIG.margin * max(z_threshold(CHANCE_RATE), (WATERMARK.planning.bit_z + 0.2) * math.sqrt(bits))


@one_blas_thread
def choose(
    model: GaussianModel,
    key: OwnerKey,
    bits: int,
    auto: Auto,
    original_sha256: str,
    cameras: Sequence[Camera] | None = None,
) -> Choice:
    """The cheapest settings that are predicted to do: the fewest views that do, then the highest fidelity that does.

    Deterministic. InputError if no copy of the model could be registered.

    Parameters
    ----------
    key : OwnerKey
        Draws the key views, on which the mark is rehearsed as it will be made; its chips are not looked at.
    auto : Auto
        The number of cells is not chosen: fewer save no time, more show no better.
    original_sha256 : str
        Hex digest of the owner's file.
    cameras : sequence of Camera, optional
        The owner's own.
    """
    wanted, tried, allowed = wanted_z(bits), 0, auto.start.prune.budget_db
    whole = replace(auto.start, prune=replace(auto.start.prune, budget_db=None))
    for views in _CONFIG.views:
        tried += 1
        # A loss is measured where it is seen: on large views.
        config = replace(whole, views=views, view_size=_CONFIG.view_size if allowed is None else whole.view_size)
        ground = lay_groundwork(model, key, original_sha256, config, cameras)
        scene = Rehearsing(deliver(ground, config, Clock()))
        found = scene.at(config)
        if found.held_out_db >= config.psnr_db - _CONFIG.slack_db:
            break
    if found.predicted_z < wanted and not auto.keep_psnr:
        faithful = config
        for lower in _CONFIG.lower_db:
            config = _lowered(faithful, lower)
            found, tried = scene.at(config), tried + 1
            if found.predicted_z >= wanted:
                break
    delivery, spent = replace(scene.delivery, settings=config), None
    if allowed is not None:
        delivery, found, spent = _spend(ground, delivery, found, auto, allowed, wanted)
        tried += sum(way.predicted_z is not None for way in spent.ways)
    return Choice(found, wanted, tried, ground, delivery, spent)


def _spend(
    ground: Groundwork, kept: Delivery, found: Rehearsal, auto: Auto, allowed_db: float, wanted: float
) -> tuple[Delivery, Rehearsal, Spent]:
    """The smallest file within the allowance that shows as much of the mark as is wanted, or nearly what there is."""
    config, least = kept.settings, min(wanted, _CONFIG.kept_share * found.predicted_z)
    # Which is smallest is seen without recovery, which takes most of the time.
    degree = kept.model.sh_degree
    made = [deliver(ground, _recovering(way, False), Clock()) for way in ways(config, allowed_db, degree)]
    within = [one for one in made if (one.pruned.psnr_pruned_worst_view or 0.0) >= allowed_db]
    # The whole file: a palette (.sog) costs a part as much as all.
    weighed = sorted(((len(encode_model(one.model, auto.format)), one) for one in within), key=lambda each: each[0])
    whole, chosen = len(encode_model(kept.model, auto.format)), None
    tried: list[Way] = []
    for size, one in weighed:
        z, degree = None, one.model.sh_degree
        if chosen is None and size < whole:
            if config.prune.recover:
                one = deliver(ground, _recovering(one.settings, True), Clock())
                size = len(encode_model(one.model, auto.format))
            promise = Rehearsing(one).at(one.settings)
            z = promise.predicted_z
            if z >= least:
                chosen, kept, found = degree, one, promise
        tried.append(Way(degree, len(one.model), size, z))
    return kept, found, Spent(allowed_db, chosen, whole, tuple(tried))


def _recovering(config: EmbedConfig, recover: bool) -> EmbedConfig:
    return replace(config, prune=replace(config.prune, recover=recover))


def _lowered(config: EmbedConfig, by: float) -> EmbedConfig:
    """Less fidelity, more evidence."""
    return replace(config, psnr_db=max(config.psnr_db - by, 20.0), ssim=config.ssim - _CONFIG.ssim_per_db * by)
