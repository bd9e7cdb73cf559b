"""What attacks leave of a mark: bits, z and claim from models, pictures and screenshots of unknown camera.

Extraction is informed: every row was read with the owner's record.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from engine.flows.embed.profiles import profile as named_profile
from engine.flows.verify.search import Verification, VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.formats import read_model
from engine.lab.evaluate.marked_scene import MarkedScene, mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import image_attack
from engine.lab.sim.suite import Trial, apply_chain
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.raster import render

BITS = 32


def to_8_bit(image: Float32) -> Float32:
    """What a stored picture holds."""
    return (np.round(np.clip(image, 0, 1) * 255) / 255).astype(np.float32)


def read_attacked(
    scene: MarkedScene,
    trial: Trial,
    seed: int | Sequence[int],
    target: GaussianModel | Float32,
    camera: Camera | None = None,
) -> Verification:
    """The claim that is left after a trial's attacks on a model, or on one stored picture; `camera` None: unknown."""
    suspect = apply_chain(target, trial, seed)
    if trial.kind == "image":
        cameras = None if camera is None else [camera]
        return verify_images([to_8_bit(suspect)], scene.opened, VerifyConfig(), cameras=cameras)
    return verify_model(suspect, scene.opened, VerifyConfig(route="model"))


def claim_row(name: str, verification: Verification) -> Row:
    """One line of a table of attacks."""
    claim = verification.claim
    return {
        "attack": name,
        "bit_accuracy": claim.bit_accuracy,
        "z": claim.z,
        "log10_false_claim": claim.log10_false_claim,
        "verdict": claim.verdict.value,
        "derived_fraction": claim.derived_fraction,
        "seconds": verification.seconds,
    }


def other_views(model: GaussianModel, count: int, size: int, seed: Sequence[int]) -> list[Camera]:
    """Square views of the kind the key views are, drawn without the key."""
    return make_rig(model, count, size, size, jitter=np.random.default_rng(seed).random((count, 4)))


def random_view(model: GaussianModel, rng: np.random.Generator, width: int, height: int) -> Camera:
    """A view a person might take: around the object or in the room, any focal length of 0.7 to 1.5 widths."""
    extent = measure_extent(model)
    base = make_rig(model, 1, width, height, jitter=rng.random((1, 4)), extent=extent)[0]
    eye = base.position
    target = extent.center + rng.normal(0.0, 0.1, 3) * extent.radius
    if extent.is_room:
        target = eye + base.viewmat[2, :3] * extent.radius
    eye = target + (eye - target) * rng.uniform(0.7, 1.2)
    up = np.array([0.0, -1.0, 0.0]) + rng.normal(0.0, 0.08, 3)
    return look_at(eye, target, up, rng.uniform(0.7, 1.5) * width, width, height)


_DARK = 0.05
"""Sum of the channels of a pixel that shows nothing."""


def measure_screenshots(scene: str, seed: int, profile: str, trials: int, other: str | None) -> list[Row]:
    """Screenshots of the marked scene and, as many as a fifth, of another scene where there is one."""
    marked = mark_scene(scene, named_profile(profile), seed=seed)
    rows = [{"source": "own", **row} for row in read_screenshots(marked, trials, seed)]
    if other is not None:
        foreign = read_screenshots(marked, -(-trials // 5), seed, read_model(other).model)
        rows += [{"source": Path(other).name, **row} for row in foreign]
    return rows


def read_screenshots(scene: MarkedScene, trials: int, seed: int = 0, foreign: GaussianModel | None = None) -> list[Row]:
    """800x600 screenshots, JPEG 80, camera and focal length unknown, a part cut out of each, each on a page, scaled
    unevenly, and photographed off a screen; and the same views as they are, blurred over 15 pixels and by a lens of
    3 pixels; of `foreign` where given."""
    source = foreign or scene.marked
    rows = []
    for trial in range(trials):
        rng = np.random.default_rng((seed, trial))
        camera = random_view(source, rng, 800, 600)
        sharp = to_8_bit(render(source, camera))
        picture = image_attack("jpeg").apply(sharp, 80, rng=rng)
        for name, shown in (
            ("screenshot", picture),
            ("part of it", _part(picture, rng)),
            ("on a page", _page(picture, rng)),
            ("scaled unevenly", _uneven(picture, rng)),
            ("off a screen", photograph(picture, rng)),
            ("motion blur", to_8_bit(image_attack("motion_blur").apply(sharp, 15.0, rng=rng))),
            ("out of focus", to_8_bit(image_attack("blur").apply(sharp, 3.0, rng=rng))),
        ):
            result = verify_images([shown], scene.opened, VerifyConfig())
            rows.append({"scene": scene.name, "trial": trial, **claim_row(name, result)})
    return rows


def _part(picture: Float32, rng: np.random.Generator) -> Float32:
    """A cutting from a screenshot (H, W, 3) over black: 40 to 70 % of its sides, of ten places the one that shows most.
    Its middle is no longer the camera's."""
    height, width = (round(float(side)) for side in rng.uniform(0.4, 0.7) * np.array(picture.shape[:2]))
    corners = rng.integers(0, [picture.shape[0] - height, picture.shape[1] - width], (10, 2))
    parts = [picture[top : top + height, left : left + width] for top, left in corners]
    return np.ascontiguousarray(max(parts, key=lambda part: float((part.sum(axis=2) > _DARK).mean())))


def _page(picture: Float32, rng: np.random.Generator) -> Float32:
    """A picture in one grey that shows this one (H, W, 3) somewhere, as wide as a half to nine tenths of it."""
    height, width = (round(float(side)) for side in np.array(picture.shape[:2]) / rng.uniform(0.5, 0.9, 2))
    page = np.full((height, width, 3), rng.random(), dtype=np.float32)
    top, left = rng.integers(0, [height - picture.shape[0], width - picture.shape[1]])
    page[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return page


def _uneven(picture: Float32, rng: np.random.Generator) -> Float32:
    """A picture (H, W, 3) that was made to fit another shape: up to a quarter narrower, a third wider."""
    width = round(picture.shape[1] * float(np.exp(rng.uniform(np.log(0.75), np.log(4 / 3)))))
    return np.asarray(cv2.resize(picture, (width, picture.shape[0]), interpolation=cv2.INTER_AREA), dtype=np.float32)


def photograph(picture: Float32, rng: np.random.Generator) -> Float32:
    """A photograph of a screen that shows this picture (H, W, 3): a corner up to a twentieth of the width from where it
    would be seen from straight ahead, a little soft, noisy and pale, JPEG 85."""
    height, width = picture.shape[:2]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    seen = corners + 0.1 * np.array([width, height]) + rng.uniform(-0.05, 0.05, (4, 2)) * width
    matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), seen.astype(np.float32))
    size = (round(1.2 * width), round(1.2 * height))
    room = (0.35, 0.34, 0.33)
    photo = cv2.warpPerspective(picture, matrix, size, flags=cv2.INTER_AREA, borderValue=room)
    photo = 0.9 * cv2.GaussianBlur(photo, (0, 0), 0.7) + 0.04 + rng.normal(0.0, 0.01, photo.shape)
    return image_attack("jpeg").apply(np.clip(photo, 0.0, 1.0).astype(np.float32), 85, rng=rng)
