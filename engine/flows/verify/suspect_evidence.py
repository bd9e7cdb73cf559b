"""From a suspect to evidence about each chip, along the three routes: Gaussians, renders at the pose key, pictures.

Of the copy layer there is one reading for all copies of an asset, blind to the chips of each. The owner's layer is
known to the reader, and taken off first: signs of one layer are fair whatever the other's are.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from engine.errors import InputError
from engine.flows.embed.landmark_bank import bank_views
from engine.flows.progress import Clock
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.appearance_search import place_by_looking
from engine.flows.verify.config import CONFIG
from engine.flows.verify.reference_views import ReferenceView, ReferenceViews
from engine.flows.views.camera_rig import Extent, make_rig, measure_extent
from engine.flows.views.render_cost import check_drawable
from engine.model import Bool, Camera, Float32, GaussianModel
from engine.numerics.similarity import mirror_model
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.pictures.alignment.background import Background, find_background
from engine.pictures.alignment.blur import Blur
from engine.pictures.alignment.color_change import Alike, ColorChange, ColorSmoothing
from engine.pictures.alignment.local_flow import align_locally
from engine.pictures.alignment.planar import (
    Alignment,
    align_either_hand,
    align_image,
    align_near,
    align_upright,
    near_motions,
)
from engine.pictures.camera.camera_motion import carried, project
from engine.pictures.camera.camera_search import FoundCamera, find_camera, follow_camera
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.pose_refinement import refine_level
from engine.pictures.jpeg.coded_blocks import JpegGrid, agreement, find_grid, match_exposure
from engine.pictures.landmarks.keypoints import luma
from engine.raster import RasterSettings, render
from engine.registration.registration_search import Registration
from engine.registration.visibility import only_drawn
from engine.watermark.claim import NOT_FOUND, Derivation
from engine.watermark.image_evidence import PictureEvidence, gather_again
from engine.watermark.model_evidence import Evidence
from engine.watermark.picture_agreement import Together

_CONFIG = CONFIG.evidence


@dataclass(frozen=True, eq=False)
class _Laid:
    """A picture over a view of the reference."""

    view: ReferenceView
    alignment: Alignment
    behind: Background | None  # what it shows behind the model

    @property
    def mask(self) -> Bool:
        """(H, W) the pixels that carry evidence."""
        return self.alignment.mask if self.behind is None else self.alignment.mask & self.behind.trusted

    def read(self, image: Float32) -> PictureEvidence:
        """What the picture says, of which `image` is what was laid over."""
        if self.behind is not None and self.alignment.still:  # as its coder saw it
            return self.view.read(image, self.mask, self.behind.through)
        return self.view.read(self.alignment.warped, self.mask)

    def washed(self) -> "_Laid":
        """The picture over the reference with its colors changed, where those of the picture's model were."""
        reference = self.view.of.changed_as(self.view, self.alignment.warped, self.mask)
        if reference is None:
            return self
        seen = self.view.view
        return replace(self, view=reference.at(seen.camera, seen.geometry.settings))


@dataclass(frozen=True, eq=False)
class ReadPicture:
    """What one picture says, and how it was read."""

    evidence: PictureEvidence
    mirrored: bool = False  # it was turned over
    blur: Blur | None = None  # it was compared with a render blurred so
    change: ColorChange | None = None  # or with one of a reference whose colors were changed so


def read_known(image: Float32, camera: Camera, reference: ReferenceViews) -> ReadPicture | None:
    """One picture (h, w, 3) from a known camera, None where it does not fit that camera's view."""
    view = reference.at(camera)
    alignment = align_either_hand(view.plain, image)
    if alignment is None:
        return None
    face, view = alignment.suspect, view.blurred_as(alignment.warped, alignment.mask)
    if view.blur is not None:
        laid = _Laid(view, align_image(view.plain, face) or alignment, None)
    else:
        laid = _carried(_Laid(view, alignment, None), face, reference, RasterSettings(), False)
    laid = laid.washed()
    return ReadPicture(laid.read(face), alignment.mirrored, view.blur, laid.view.of.change)


def read_found(image: Float32, found: FoundCamera, reference: ReferenceViews) -> ReadPicture | None:
    """A picture (h, w, 3) whose camera was found, whatever it shows behind the model, and of a model that
    was bent, part by part."""
    tone = reference.tone(found.camera, found.settings, image)
    view = reference.at(found.camera, found.settings, tone).blurred_as(image)
    (whole, change), bent = _read_whole(view, image, found, reference), align_locally(view.plain, view.alpha, image)
    if bent is not None:  # no camera says where it is clear, and so what lies behind
        parts = view.read(bent.warped, bent.mask)
        whole = parts if whole is None or parts.promise > whole.promise else whole
        change = None if whole is parts else change
    return None if whole is None else ReadPicture(whole, found.mirrored, view.blur, change)


def _read_whole(
    view: ReferenceView, image: Float32, found: FoundCamera, reference: ReferenceViews
) -> tuple[PictureEvidence | None, ColorChange | None]:
    laid = _lay_over_background(view, image)
    if laid is None:
        return None, None
    if view.blur is None:  # else the coder's multiples are not the render's: the search would end where it began
        laid = _carried(laid, image, reference, found.settings, True)
    laid = laid.washed()
    return laid.read(image), laid.view.of.change


def _lay_over_background(view: ReferenceView, image: Float32) -> _Laid | None:
    behind = find_background(image, view.alpha)
    alignment = align_near(view.plain, image if behind is None else image - behind.through)
    return None if alignment is None else _Laid(view, alignment, behind)


def _carried(laid: _Laid, image: Float32, reference: ReferenceViews, drawn: RasterSettings, over: bool) -> _Laid:
    """The picture in its own pixels, where it shows a coder's blocks and a camera can be carried there; else as it
    was.

    Brightness tells where it lies but for what a coarse coder makes up. Of what is near, the camera answers from which
    that coder would have stored most of what it did.
    """
    height, width = image.shape[:2]
    motion = laid.alignment.matrix
    if np.linalg.det(motion[:2, :2]) < 0:  # no camera turns a picture over
        image = np.ascontiguousarray(image[:, ::-1])
        motion = np.array([[-1.0, 0.0, width], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ motion
    grid = None if laid.alignment.still else find_grid(image)
    if grid is None:
        return laid
    best, most = laid, 0.0
    for start in near_motions(motion, laid.view.plain.shape[:2]):
        camera, matrix = laid.view.view.camera, start
        for _ in range(_CONFIG.carried):
            there = carried(camera, matrix, width, height)
            if there is None:
                break
            view = reference.at(there, drawn, laid.view.tone)
            behind = find_background(image, view.alpha) if over else None
            through = np.float32(0.0) if behind is None else behind.through
            near = align_upright(view.plain, image - through)
            if near is None:
                break
            camera, (matrix, alignment) = there, near
            own = _Laid(view, alignment, behind)
            agreed = _agreement(own, image, grid)
            if agreed > most:
                best, most = own, agreed
        if most < _CONFIG.coded_alike:
            return laid
    for own in [replace(best, view=best.view.softened(blur)) for blur in _CONFIG.soft] if best is not laid else []:
        if (as_soft := _agreement(own, image, grid)) > most:
            best, most = own, as_soft
    return best


def _agreement(own: _Laid, image: Float32, grid: JpegGrid) -> float:
    through = np.float32(0.0) if own.behind is None else own.behind.through
    mask = own.alignment.mask
    exposed = np.clip(match_exposure(own.view.plain, image - through, mask, grid.quality) + through, 0.0, 1.0)
    return agreement(grid.part(exposed), grid.part(image), grid.part(mask), grid.quality)


def derivation_of_sight(of_model: Derivation, recognised: bool) -> Derivation:
    """What renders of a suspect model say, in addition to its Gaussians: views recognised by themselves, or nothing."""
    if of_model.derived or not recognised:
        return of_model
    return Derivation(True, of_model.share or None, of_model.gaussians)


def derivation_of_pictures(shown: int, pictures: int, found: bool) -> Derivation:
    """What pictures say of which so many show the asset; `found`: their cameras were found, by recognising it.

    Where the cameras were given, a picture of anything that is bright in the same places can be laid over a view.
    """
    return Derivation(shown > 0, views=(shown, pictures)) if found else NOT_FOUND


KEY_VIEWS = "further renders of the pose key"
"""What the time budget did not allow."""
DRAWN_ANEW = "none of its Gaussians was matched with one of the asset's: it may have been trained or drawn anew"
SHOWN_IN_PLACE = f"the suspect model shows the asset where it lies; {DRAWN_ANEW}"
LEFT_OUT = "left out: picture {} shows the asset, but not the mark that the other pictures agree on"


@dataclass(frozen=True, eq=False)
class Seen:
    """What renders of a suspect model say."""

    evidence: Evidence  # all zero where no view could be read
    notes: tuple[str, ...]  # how the model was placed, where not by its Gaussians
    shown: bool  # whether the suspect shows the asset, as far as it must for being read
    recognised: bool = False  # whether several of its views were recognised by themselves, which tells it from others


def read_renders(
    suspect: GaussianModel,
    opened: OpenedRecord,
    registration: Registration,
    clock: Clock,
    budget: TimeBudget = UNLIMITED,
) -> Seen:
    """The suspect as a black box: rendered, and read as pictures.

    Where registration of the Gaussians found the one similarity that holds, the renders at the pose key need no
    alignment. A model that shares no Gaussian with the reference is placed by what it looks like; then each view's
    camera is refined on its picture, and the views by which the model was recognised are read, too. It is drawn as the
    reference is, whatever its own tag says, which anybody may change. InputError if that would take hours.
    """
    suspect = only_drawn(suspect)
    check_drawable(suspect)
    suspect = replace(suspect, antialiased=opened.reference.antialiased)
    if registration.found and not registration.deformed:
        return _seen_placed(registration.place(suspect), opened, clock, budget)
    if registration.mirrored:
        suspect = mirror_model(suspect)
    cameras = [camera.with_side(_CONFIG.render_size) for camera in opened.cameras]
    said: PictureEvidence | None = None
    notes = []
    moved, reference = suspect, ReferenceViews(opened)
    place = None
    off = _in_place(suspect, opened, cameras)
    sure = len(off) >= min(_CONFIG.glances, len(cameras))
    if off:
        notes += [] if registration.found else [SHOWN_IN_PLACE]
        if sure and max(off) < _CONFIG.exact:
            seen = _seen_placed(suspect, opened, clock, budget)
            return replace(seen, notes=(*notes, *seen.notes), recognised=not registration.found)
    elif opened.landmarks is not None:
        place = place_by_looking(suspect, opened.reference, opened.landmarks, clock.advance, budget)
        if place is None:
            return Seen(_nothing(opened), ("no view of the suspect model was recognised as this asset",), False)
        moved = place.place(suspect)
        count = f"{len(place.sightings)} of {place.views} views"
        it = "its mirror image" if place.mirrored else "it"
        notes.append(f"the suspect was placed by what it looks like: {count} of {it} were recognised")
        notes += [] if registration.found else [DRAWN_ANEW]
        for sighting in place.sightings:
            read = read_known(sighting.picture, sighting.found, reference)
            said = _added(said, None if read is None else read.evidence)
            reference = _changed_as_read(reference, read)
    for number, camera in enumerate(cameras):
        if said is not None and not budget.allows(KEY_VIEWS):
            break
        picture = np.clip(render(moved, camera), 0.0, 1.0)
        refined = refine_level(opened.reference, luma(picture), camera, _CONFIG.refinements, _CONFIG.refined)
        if refined is not None and refined.alike:
            read = read_known(picture, refined.camera, reference)
            said = _added(said, None if read is None else read.evidence)
            reference = _changed_as_read(reference, read)
        clock.advance((number + 1) / len(cameras))
    notes += _how_changed(reference)
    recognised = place is not None or (sure and not registration.found)
    return Seen(_evidence(said, opened), tuple(notes), said is not None, recognised)


def _changed_as_read(reference: ReferenceViews, read: ReadPicture | None) -> ReferenceViews:
    """The reference as the next views of the same model are compared with: how its colors were changed, one tells."""
    if read is None or read.change is None or reference.change is not None:
        return reference
    return ReferenceViews(reference.opened, read.change)


def _how_changed(reference: ReferenceViews) -> Iterator[str]:
    if reference.change is not None:
        yield _washed("the suspect looks like", reference.change)


def _washed(what: str, change: ColorChange) -> str:
    how = "averaged over neighbors" if isinstance(change, ColorSmoothing) else "denoised"
    if isinstance(change, ColorSmoothing) and isinstance(change.neighborhoods, Alike):
        how = "averaged over neighbors of like color"
    return f"{what} a model whose colors were {how}: it was compared with the original changed alike"


def _seen_placed(moved: GaussianModel, opened: OpenedRecord, clock: Clock, budget: TimeBudget) -> Seen:
    """What the pose key's renders say of a model that lies where the reference lies, to the last digit."""
    said, reference = None, ReferenceViews(opened)
    for number, camera in enumerate(camera.with_side(_CONFIG.render_size) for camera in opened.cameras):
        if said is not None and not budget.allows(KEY_VIEWS):
            break
        picture = np.clip(render(moved, camera), 0.0, 1.0)
        view, mask = reference.at(camera), np.ones(picture.shape[:2], dtype=bool)
        if number == 0 and (changed := reference.changed_as(view, picture, mask)) is not None:
            reference = changed
            view = reference.at(camera)
        said = _added(said, view.read(picture, mask))
        clock.advance((number + 1) / len(opened.cameras))
    return Seen(_evidence(said, opened), tuple(_how_changed(reference)), True)


def _added(said: PictureEvidence | None, part: PictureEvidence | None) -> PictureEvidence | None:
    """What was said so far, and what one more picture says; None where nothing is."""
    return said.plus(part) if said is not None and part is not None else said or part


def _in_place(suspect: GaussianModel, opened: OpenedRecord, cameras: Sequence[Camera]) -> list[float]:
    """From up to `glances` views, how far the suspect lies from where the reference lies, pixels, until it looks unlike
    it: a copy trained anew was hardly ever moved."""
    means = opened.reference.means[:: max(1, len(opened.reference) // _CONFIG.glance_points)].astype(np.float64)
    off: list[float] = []
    for camera in cameras[:: max(1, len(cameras) // _CONFIG.glances)][: _CONFIG.glances]:
        picture = np.clip(render(suspect, camera), 0.0, 1.0)
        refined = refine_level(opened.reference, luma(picture), camera, _CONFIG.refinements, _CONFIG.refined)
        if refined is None or not refined.alike:
            break
        off.append(float(np.median(np.linalg.norm(project(means, camera) - project(means, refined.camera), axis=1))))
    return off


def read_pictures(
    images: Sequence[Float32],
    opened: OpenedRecord,
    cameras: Sequence[Camera] | None,
    clock: Clock,
    budget: TimeBudget = UNLIMITED,
) -> tuple[Evidence, Evidence, tuple[str, ...], tuple[Camera | None, ...]]:
    """What pictures (h, w, 3), range 0 to 1, say about each chip, all together, read in the two ways of
    `PictureEvidence`; why one could not be read, or was left out since it contradicts the others; and from where each
    that was read shows the asset.

    Cameras that are not given are found from the record's landmarks. The evidence is all zero where no picture could
    be read. InputError if there is no picture, the cameras are not as many, or one must be found without landmarks.
    """
    if not images:
        raise InputError("no picture was given")
    if cameras is not None and len(cameras) != len(images):
        raise InputError(f"{len(images)} pictures but {len(cameras)} cameras")
    said = Together()
    notes: list[str] = []
    seen: list[Camera | None] = [None] * len(images)
    last: FoundCamera | None = None
    reference = ReferenceViews(opened)
    extent = cache(lambda: measure_extent(opened.reference))
    far = cache(lambda: far_views(opened.reference, extent()))
    bank = cache(lambda: [] if opened.landmarks is None else bank_views(opened.landmarks, opened.reference, extent()))
    for number, image in enumerate(images):
        if not budget.allows(f"pictures {number + 1} to {len(images)}"):
            break
        camera = cameras[number] if cameras is not None else None
        if camera is None:
            with clock.stage("find camera"):
                found = None if last is None else follow_camera(opened.reference, image, last)
                found = found or _find(image, opened, far, bank)
            if found is None:
                notes.append(f"picture {number + 1}: no view of this asset was recognised")
                continue
            last, camera = found, found.of_whole(image)
            with clock.stage("read picture"):
                read = read_found(found.face(image), found, reference)
        else:
            with clock.stage("read picture"):
                read = read_known(image, camera, reference)
        if read is None:
            notes.append(f"picture {number + 1}: it could not be aligned to the view of its camera")
            continue
        said.add(number, read.evidence)
        seen[number] = camera
        notes += _how_read(number, read)
    together, odd = said.agreed()
    notes += [LEFT_OUT.format(number + 1) for number in odd]
    scattered = _nothing(opened) if together is None else together.by_scatter(opened.strength)
    return _evidence(together, opened), scattered, tuple(notes), tuple(seen)


def far_views(model: GaussianModel, extent: Extent | None = None) -> FarViews:
    """The model from afar, from all around: where pictures without keypoints are sought."""
    extent = extent or measure_extent(model)
    wide = make_rig(model, _CONFIG.edge_views, *_CONFIG.edge_size, extent=extent, elevations=_CONFIG.edge_elevations)
    return FarViews(model, wide, make_rig(model, _CONFIG.close_views, *_CONFIG.edge_size, extent=extent))


def _how_read(number: int, read: ReadPicture) -> Iterator[str]:
    """How a picture was read, for the reader of the claim."""
    if read.mirrored:
        yield f"mirrored: picture {number + 1} was turned over before it was read"
    if read.blur is not None:
        long, short = read.blur.widths
        how = f"standard deviations {long:.1f} and {short:.1f} pixels"
        yield f"blurred: picture {number + 1} was compared with renders blurred alike ({how})"
    if read.change is not None:
        yield _washed(f"picture {number + 1} looks like one of", read.change)


def _find(
    image: Float32, opened: OpenedRecord, far: Callable[[], FarViews], bank: Callable[[], Sequence[Camera]]
) -> FoundCamera | None:
    if opened.landmarks is None:
        raise InputError("this record has no landmarks: give --cameras, or embed with a landmark bank")
    return find_camera(opened.landmarks, opened.reference, image, far=far, bank=bank)


def _evidence(said: PictureEvidence | None, opened: OpenedRecord) -> Evidence:
    return _nothing(opened) if said is None else said.evidence(opened.strength)


def _nothing(opened: OpenedRecord) -> Evidence:
    zero = np.zeros(opened.layout.chips + opened.grain.chips(len(opened.reference)))
    return Evidence(zero, zero, zero)


def copy_of_pictures(opened: OpenedRecord, said: Evidence) -> Evidence | None:
    """Of pictures, from what they say of the owner's layer; None where the record has no copy layer."""
    if opened.copies is None:
        return None
    tint = gather_again(opened.copies.layout, said.pulled)
    return tint.then(said.behind(opened.layout.chips)) if opened.copies.grain.there else tint
