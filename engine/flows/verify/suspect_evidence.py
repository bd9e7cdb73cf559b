"""From a suspect to evidence about each chip, along the three routes: Gaussians, renders at the pose key, pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from engine.errors import InputError
from engine.flows.embed.landmark_bank import bank_views
from engine.flows.progress import Clock
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.appearance_search import place_by_looking
from engine.flows.verify.picture_evidence import read_found, read_known
from engine.flows.verify.reference_views import ReferenceViews
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.render_cost import check_drawable
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.similarity import mirror_model
from engine.pictures.camera.camera_search import FoundCamera, find_camera, follow_camera
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.pose_refinement import refine_level
from engine.pictures.landmarks.keypoints import luma
from engine.raster import render
from engine.registration.registration_search import Registration
from engine.watermark.grain_evidence import gather_grain_evidence
from engine.watermark.image_evidence import PictureEvidence
from engine.watermark.model_evidence import Evidence, Residual, compare_colors, gather_residual
from engine.watermark.picture_agreement import Together

__all__ = ["Seen", "compare_tint", "read_gaussians", "read_grain", "read_pictures", "read_renders", "read_tint"]

RENDER_SIZE = 512
"""Longer side of a suspect's render at the pose key, pixels, however large the key views were: all together see
enough, and soon."""
REFINEMENTS, REFINED = 12, 0.005
"""Renders at most to refine a view's camera, and the step that ends it, pixels: as `find_camera` does."""
EDGE_VIEWS, EDGE_SIZE = 64, (640, 480)
"""Views in which a picture without keypoints is sought, and their shape."""
LEFT_OUT = "left out: picture {} shows the asset, but not the mark that the other pictures agree on"


@dataclass(frozen=True, eq=False)
class Seen:
    """What renders of a suspect model say."""

    evidence: Evidence  # all zero where no view could be read
    notes: tuple[str, ...]  # how the model was placed, where not by its Gaussians
    shown: bool  # whether the suspect shows the asset, as far as it must for being read
    recognised: bool = False  # whether several of its views were recognised by themselves, which tells it from others


def read_gaussians(suspect: GaussianModel, opened: OpenedRecord, registration: Registration) -> Evidence:
    """Displacements of the suspect's own colours from those of the Gaussians they are matched to (Eq 10), and where the
    record has a grain, of its centres and sizes.
    """
    tint = read_tint(suspect, opened, registration)
    return tint.then(read_grain(suspect, opened, registration)) if opened.grain.there else tint


def read_tint(
    suspect: GaussianModel, opened: OpenedRecord, registration: Registration, compared: Residual | None = None
) -> Evidence:
    """What the suspect's colours say, in the cells of this record's copy; `compared` as `compare_tint` gives it."""
    if compared is None:
        compared = compare_tint(suspect, opened, registration)
    tint = gather_residual(opened.layout, compared)
    return replace(tint, signal=opened.strength * tint.signal)


def compare_tint(suspect: GaussianModel, opened: OpenedRecord, registration: Registration) -> Residual:
    """How far the suspect's colours lie from the reference's: the same for copies with carriers of the same width."""
    seen = suspect if opened.layout.width == 3 else registration.place(suspect)  # DC is the same from everywhere
    reference, colors = (model.sh.reshape(len(model), -1) for model in (opened.reference, seen))
    width = min(opened.layout.width, colors.shape[1])
    return compare_colors(reference[:, :width], colors[:, :width], registration.mixtures)


def read_grain(suspect: GaussianModel, opened: OpenedRecord, registration: Registration) -> Evidence:
    """What the suspect's centres and sizes say: the same for all copies of an asset."""
    seen = mirror_model(suspect) if registration.mirrored else suspect
    pairs = registration.matches, registration.match_quality
    return gather_grain_evidence(opened.grain, opened.reference, seen, registration.similarity, *pairs)


def read_renders(suspect: GaussianModel, opened: OpenedRecord, registration: Registration, clock: Clock) -> Seen:
    """The suspect as a black box: rendered, and read as pictures.

    Where registration of the Gaussians found the one similarity that holds, the renders at the pose key need no
    alignment. A model that shares no Gaussian with the reference is placed by what it looks like; then each view's
    camera is refined on its picture, and the views by which the model was recognised are read, too. It is drawn as the
    reference is, whatever its own tag says, which anybody may change. InputError if that would take hours.
    """
    check_drawable(suspect)
    suspect = replace(suspect, antialiased=opened.reference.antialiased)
    if registration.found and not registration.deformed:
        return Seen(_evidence(_read_placed(registration.place(suspect), opened, clock), opened), (), True)
    if registration.mirrored:
        suspect = mirror_model(suspect)
    cameras = [camera.with_side(RENDER_SIZE) for camera in opened.cameras]
    said: PictureEvidence | None = None
    notes = []
    moved, reference = suspect, ReferenceViews(opened)
    place = None
    if not _in_place(suspect, opened, cameras[0]) and opened.landmarks is not None:
        place = place_by_looking(suspect, opened.reference, opened.landmarks, clock.advance)
        if place is None:
            return Seen(_nothing(opened), ("no view of the suspect model was recognised as this asset",), False)
        moved = place.place(suspect)
        count = f"{len(place.sightings)} of {place.views} views"
        it = "its mirror image" if place.mirrored else "it"
        notes.append(f"the suspect was placed by what it looks like: {count} of {it} were recognised")
        for sighting in place.sightings:
            said = _added(said, read_known(sighting.picture, sighting.found, reference)[0])
    for number, camera in enumerate(cameras):
        picture = np.clip(render(moved, camera), 0.0, 1.0)
        refined = refine_level(opened.reference, luma(picture), camera, REFINEMENTS, REFINED)
        if refined is not None and refined.alike:
            said = _added(said, read_known(picture, refined.camera, reference)[0])
        clock.advance((number + 1) / len(cameras))
    return Seen(_evidence(said, opened), tuple(notes), said is not None, place is not None)


def _read_placed(moved: GaussianModel, opened: OpenedRecord, clock: Clock) -> PictureEvidence | None:
    """Evidence of the pose key's renders of a model that lies where the reference lies, to the last digit."""
    said, reference = None, ReferenceViews(opened)
    for number, camera in enumerate(camera.with_side(RENDER_SIZE) for camera in opened.cameras):
        picture = np.clip(render(moved, camera), 0.0, 1.0)
        said = _added(said, reference.at(camera).read(picture, np.ones(picture.shape[:2], dtype=bool)))
        clock.advance((number + 1) / len(opened.cameras))
    return said


def _added(said: PictureEvidence | None, part: PictureEvidence | None) -> PictureEvidence | None:
    """What was said so far, and what one more picture says; None where nothing is."""
    return said.plus(part) if said is not None and part is not None else said or part


def _in_place(suspect: GaussianModel, opened: OpenedRecord, camera: Camera) -> bool:
    """Whether the suspect looks like the reference where it stands: a copy trained anew was hardly ever moved."""
    picture = np.clip(render(suspect, camera), 0.0, 1.0)
    refined = refine_level(opened.reference, luma(picture), camera, REFINEMENTS, REFINED)
    return refined is not None and refined.alike


def read_pictures(
    images: Sequence[Float32], opened: OpenedRecord, cameras: Sequence[Camera] | None, clock: Clock
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
    far = cache(lambda: FarViews(opened.reference, make_rig(opened.reference, EDGE_VIEWS, *EDGE_SIZE)))
    bank = cache(lambda: _bank_views(opened))
    for number, image in enumerate(images):
        camera = cameras[number] if cameras is not None else None
        if camera is None:
            with clock.stage("find camera"):
                found = None if last is None else follow_camera(opened.reference, image, last)
                found = found or _find(image, opened, far, bank)
            if found is None:
                notes.append(f"picture {number + 1}: no view of this asset was recognised")
                continue
            last, camera, turned = found, found.of_whole(image), found.mirrored
            with clock.stage("read picture"):
                evidence = read_found(found.face(image), found, reference)
        else:
            with clock.stage("read picture"):
                evidence, turned = read_known(image, camera, reference)
        if evidence is None:
            notes.append(f"picture {number + 1}: it could not be aligned to the view of its camera")
            continue
        said.add(number, evidence)
        seen[number] = camera
        if turned:
            notes.append(f"mirrored: picture {number + 1} was turned over before it was read")
    together, odd = said.agreed()
    notes += [LEFT_OUT.format(number + 1) for number in odd]
    scattered = _nothing(opened) if together is None else together.by_scatter(opened.strength)
    return _evidence(together, opened), scattered, tuple(notes), tuple(seen)


def _bank_views(opened: OpenedRecord) -> list[Camera]:
    """Where the record's landmarks were seen from."""
    return [] if opened.landmarks is None else bank_views(opened.landmarks, opened.reference)


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
