"""Choosing settings for a scene (`embed --profile auto`): the cheapest whose mark one bad picture still shows.

A scene is rehearsed (`rehearsal`). Where the owner allows a loss (a pruning budget), every way of spending it
(`ways`) is rehearsed, too, smallest file first. The same functions serve `mark3dgs evaluate --suite
pareto`, which holds every promise against what was measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from engine.flows.embed.config import CONFIG
from engine.flows.embed.delivery import Delivery, deliver
from engine.flows.embed.planning_basis import Groundwork, lay_groundwork
from engine.flows.embed.profiles import Auto, EmbedConfig
from engine.flows.embed.rehearsal import Rehearsal, Rehearsing
from engine.flows.progress import Clock
from engine.formats import encode_model
from engine.model import Camera, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.watermark.config import CONFIG as WATERMARK
from engine.watermark.keys import OwnerKey
from engine.watermark.statistics import CHANCE_RATE, z_threshold

__all__ = ["Choice", "Rehearsal", "choose", "wanted_z", "ways"]

_CONFIG = CONFIG.auto


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
