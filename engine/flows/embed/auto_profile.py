"""Choosing settings for a scene (`embed --profile auto`): the cheapest whose mark survives what the owner asks for.

A scene is rehearsed: its mark is planned and settled as it will be embedded, on the key's own cells, both layers and
the copies' where there are copies. In place of the owner's chips, which nothing may be chosen by, it gets those of a
public key. Views that no key view was are then rendered large, spoilt, and read by the reader of `verify`. What that
reader loses, the promise lacks, too: nothing is modeled.

Where the owner allows a loss (a pruning budget), every way of spending it (`ways`) is rehearsed, too, smallest file
first. `mark3dgs evaluate --suite promises` holds every promise against what pictures show.
"""

import hashlib
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from engine.flows.embed.config import CONFIG
from engine.flows.embed.copy_mark import as_a_copy
from engine.flows.embed.delivery import deliver
from engine.flows.embed.draft import Draft
from engine.flows.embed.layer_strengths import Settled
from engine.flows.embed.planning_basis import Groundwork, lay_groundwork
from engine.flows.embed.profiles import Auto, EmbedConfig
from engine.flows.embed.variant import PLAIN, Variant
from engine.flows.progress import Clock
from engine.flows.verify.reference_views import grain_view
from engine.formats import encode_model
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.numerics.image_metrics import psnr
from engine.pictures.jpeg.coded_blocks import as_jpeg
from engine.raster import Rendering, draw, render
from engine.watermark.config import CONFIG as WATERMARK
from engine.watermark.image_evidence import layer_evidence
from engine.watermark.keys import OwnerKey
from engine.watermark.spreading import ONE_BIT, grain_key, spread, spread_grain
from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE, signed_z, z_threshold

_CONFIG, _REHEARSAL = CONFIG.auto, CONFIG.rehearsal
REHEARSAL_SEED = 0x5EED
PUBLIC_KEY = OwnerKey(hashlib.sha256(b"mark3dgs rehearsal: a key that everybody knows").digest())


@dataclass(frozen=True)
class Rehearsal:
    """What a scene promises under some settings."""

    # Of the claim from one bad picture of an unseen view. Where the worst is to be survived, the least of several, and
    # under noise of std 0.1, too; else `usual_z`
    predicted_z: float
    held_out_db: float  # of the mark, worst of those views
    usual_z: float  # at JPEG quality 10, mean of several; 0 where the mark was not read


class Rehearsing:
    """A scene with a mark that is planned, whose strength is still open."""

    def __init__(self, draft: Draft, survive: str = "pictures") -> None:
        self.draft, self._survive = draft, survive
        rng = np.random.default_rng(REHEARSAL_SEED)
        self._cameras = draft.delivery.ground.unseen(_REHEARSAL.held_out, _REHEARSAL.side, rng)
        self.seconds = list[float]()  # to draw each view without and with the mark, and to read it as a JPEG

    def at(self, settled: Settled, least_db: float = 0.0) -> Rehearsal:
        """What the mark promises at a strength; it is not read on from a view that keeps less than `least_db`."""
        model, layout, grain = self.draft.delivery.model, settled.plan.layout, settled.grain
        chips = spread(PUBLIC_KEY, self.draft.digest, layout.codes, len(layout.directions[0]), 1, sized=True)
        if grain.there:
            chips = chips.then(spread_grain(grain_key(PUBLIC_KEY, self.draft.digest), len(model), 1, sized=True))
        values = chips.values(ONE_BIT)
        tint = layout.displace(layout.amplitudes * values[: layout.chips])
        rough = grain.displacements(values[layout.chips :]) if grain.there else None
        marked = as_a_copy(model, settled.copies, tint, rough)
        marked = self.draft.lattices.onto(model, marked, bytes(32))
        parts = np.split(values, [layout.chips])

        def read(drawn: Rendering, plain: Float32, camera: Camera, picture: Float32) -> float:
            seen = layer_evidence(layout, drawn.view, plain, picture, grain_view(drawn, camera, grain))
            agreeing = [one * own for one, own in zip(seen, parts, strict=False)]
            each = [signed_z(one, np.ones(len(one), dtype=np.int8)) for one in agreeing]
            # Layers are weighed by what each should show, which makes z the root of their sum of squares.
            return math.hypot(*(max(z, 0.0) for z in each))

        held_out_db, coded, noisy = np.inf, list[float](), list[float]()
        for camera in self._cameras:  # one after another: of ten million Gaussians a view takes a gigabyte
            began = time.perf_counter()
            drawn, picture = draw(model, camera), np.clip(render(marked, camera), 0.0, 1.0)
            plain = np.clip(drawn.image, 0.0, 1.0)
            held_out_db = min(held_out_db, psnr(plain, picture))
            if held_out_db < least_db:
                return Rehearsal(0.0, held_out_db, 0.0)
            if self._survive != "model":
                coded.append(read(drawn, plain, camera, as_jpeg(picture, _REHEARSAL.quality)))
                self.seconds.append(time.perf_counter() - began)
            if self._survive == "worst":
                noisy.append(read(drawn, plain, camera, _noisy(picture)))
        usual = float(np.mean(coded)) if coded else 0.0
        return Rehearsal(min(coded + noisy) if noisy else usual, held_out_db, usual)


def _noisy(picture: Float32) -> Float32:
    """The picture under noise, as it is stored."""
    noise = np.random.default_rng(REHEARSAL_SEED).normal(0.0, _REHEARSAL.noise, picture.shape)
    return (np.round(np.clip(picture + noise, 0.0, 1.0) * 255.0) / 255.0).astype(np.float32)


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

    @property
    def saved(self) -> int:
        """Bytes of the whole file that the way taken does without."""
        return sum(self.bytes_whole - way.bytes for way in self.ways if way.sh_degree == self.sh_degree)


@dataclass(frozen=True, eq=False)
class Choice:
    """The settings chosen for a scene."""

    config: EmbedConfig
    rehearsal: Rehearsal  # of these settings
    survive: str
    wanted_z: float  # 0 where no picture need show the mark
    tried: int  # settings rehearsed
    ground: Groundwork  # of the model as it came
    draft: Draft  # what was rehearsed; `embed` goes on from it,
    settled: Settled  # at this strength
    spent: Spent | None  # on what the owner's allowance went, where there was one
    saved_seconds: float | None  # as in ChoiceReport

    @property
    def met(self) -> bool:
        """Whether what was asked for is predicted to show all bits and a claim.

        Where nothing meets that, the choice is the strongest; better pictures, several, or the model itself may still
        show everything.
        """
        return self.rehearsal.predicted_z >= self.wanted_z

    def report(self) -> "ChoiceReport":
        """The choice in plain values."""
        config, found = self.config, self.rehearsal
        return ChoiceReport(
            views=config.views,
            view_size=config.view_size,
            psnr_db=config.psnr_db,
            predicted_z=found.predicted_z,
            predicted_held_out_db=found.held_out_db,
            survive=self.survive,
            wanted_z=self.wanted_z,
            met=self.met,
            tried=self.tried,
            spent=self.spent,
            saved_bytes=0 if self.spent is None else self.spent.saved,
            saved_seconds=self.saved_seconds,
        )


@dataclass(frozen=True)
class ChoiceReport:
    """A choice as `embed --json` tells it: settings, what they promise of one bad picture, and what was wanted."""

    views: int
    view_size: int  # pixels
    psnr_db: float
    predicted_z: float
    predicted_held_out_db: float  # dB, in views that were not looked at
    survive: str  # what `predicted_z` is of
    wanted_z: float
    met: bool
    tried: int  # settings rehearsed
    spent: Spent | None
    saved_bytes: int  # of the delivered file, before its mark; nothing is lost, and nothing saved, without an allowance
    # Against profile `balanced`, of the first copy, landmarks left aside; below 0 where choosing took longer. Estimated
    # from how long the pictures here took. None where none was read, the owner named the views or allowed a loss
    saved_seconds: float | None = field(compare=False)


def wanted_z(bits: int, survive: str = "pictures") -> float:
    """z that a picture must be predicted to give: a claim at 2^-128 and every bit clear, with a `margin`.

    A bit's z is the message's over the root of its length; `bit_z` of them is what the planner accepts.
    """
    if survive == "model":
        return 0.0
    needed = z_threshold(DISHONEST_CLAIMANT_RATE), (WATERMARK.planning.bit_z + 0.2) * math.sqrt(bits)
    return _CONFIG.margin * max(needed)


@one_blas_thread
def choose(
    model: GaussianModel,
    key: OwnerKey,
    bits: int,
    auto: Auto,
    original_sha256: str,
    cameras: Sequence[Camera] | None = None,
    variant: Variant = PLAIN,
    *,
    copied: bool = False,
) -> Choice:
    """The cheapest settings that are predicted to do: the fewest views that do, then the highest fidelity that does.

    Deterministic. InputError if no copy of the model could be registered.

    Parameters
    ----------
    key : OwnerKey
        Draws the key views and cells, on which the mark is rehearsed as it will be made; its chips are not looked at.
    auto : Auto
        The number of cells is not chosen: fewer save no time, more show no better.
    original_sha256 : str
        Hex digest of the owner's file.
    cameras : sequence of Camera, optional
        The owner's own.
    copied : bool
        Whether copies will have a layer of their own on top.
    """
    began, a_view = time.perf_counter(), list[float]()
    wanted, tried, allowed = wanted_z(bits, auto.survive), 0, auto.start.prune.budget_db
    whole = replace(auto.start, prune=replace(auto.start.prune, budget_db=None))
    if allowed is None and "view_size" not in auto.kept:  # a loss is measured where it is seen: on large views
        whole = replace(whole, view_size=_CONFIG.view_size)
    if auto.survive == "model" and "landmark_views" not in auto.kept:
        whole = replace(whole, landmark_views=0)
    counts = (whole.views,) if "views" in auto.kept else _CONFIG.views
    for views in counts:
        tried += 1
        config = replace(whole, views=views)
        ground = lay_groundwork(model, key, original_sha256, config, cameras, variant)
        draft = Draft(deliver(ground, config, Clock()), variant, key, copied)
        scene, settled = Rehearsing(draft, auto.survive), draft.settle(config)
        slack = 0.0 if views == counts[-1] else config.psnr_db - _CONFIG.slack_db
        found = scene.at(settled, slack)
        a_view += scene.seconds
        if found.held_out_db >= slack:
            break
    if found.predicted_z < wanted and not auto.kept & {"psnr_db", "ssim"}:
        faithful, lower_db = config, _CONFIG.lower_db
        # z grows at most as the amplitude does: what would not do then is not rehearsed.
        for lower in [by for by in lower_db[:-1] if found.predicted_z * 10 ** (by / 20.0) >= wanted] + [lower_db[-1]]:
            config = _lowered(faithful, lower)
            settled = draft.settle(config)
            found, tried = scene.at(settled), tried + 1
            if found.predicted_z >= wanted:
                break
    saved = None
    if allowed is None and a_view and not auto.kept & {"views", "view_size"}:
        saved = _CONFIG.balanced_views * float(np.mean(a_view)) - (time.perf_counter() - began)
    choice = Choice(config, found, auto.survive, wanted, tried, ground, draft, settled, None, saved)
    return choice if allowed is None else _spend(choice, auto, allowed)


def _spend(kept: Choice, auto: Auto, allowed_db: float) -> Choice:
    """The smallest file within the allowance that shows as much of the mark as is wanted, or nearly what there is."""
    ground, draft, choice = kept.ground, kept.draft, kept
    least = min(kept.wanted_z, _CONFIG.kept_share * kept.rehearsal.predicted_z)
    # Which is smallest is seen without recovery, which takes most of the time.
    degree = draft.delivery.model.sh_degree
    made = [deliver(ground, _recovering(way, False), Clock()) for way in ways(kept.config, allowed_db, degree)]
    within = [one for one in made if (one.pruned.psnr_pruned_worst_view or 0.0) >= allowed_db]
    # The whole file: a palette (.sog) costs a part as much as all.
    weighed = sorted(((len(encode_model(one.model, auto.format)), one) for one in within), key=lambda each: each[0])
    whole, chosen = len(encode_model(draft.delivery.model, auto.format)), None
    tried: list[Way] = []
    for size, one in weighed:
        z, degree = None, one.model.sh_degree
        if chosen is None and size < whole:
            if kept.config.prune.recover:
                one = deliver(ground, _recovering(one.settings, True), Clock())
                size = len(encode_model(one.model, auto.format))
            other = replace(draft, delivery=one)
            settled = other.settle(one.settings)
            promise = Rehearsing(other, auto.survive).at(settled)
            z = promise.predicted_z
            if z >= least:
                chosen = degree
                choice = replace(kept, config=one.settings, rehearsal=promise, draft=other, settled=settled)
        tried.append(Way(degree, len(one.model), size, z))
    rehearsed = kept.tried + sum(way.predicted_z is not None for way in tried)
    return replace(choice, tried=rehearsed, spent=Spent(allowed_db, chosen, whole, tuple(tried)))


def _recovering(config: EmbedConfig, recover: bool) -> EmbedConfig:
    return replace(config, prune=replace(config.prune, recover=recover))


def _lowered(config: EmbedConfig, by: float) -> EmbedConfig:
    """Less fidelity, more evidence."""
    return replace(config, psnr_db=max(config.psnr_db - by, 20.0), ssim=config.ssim - _CONFIG.ssim_per_db * by)
