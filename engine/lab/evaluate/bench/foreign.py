"""Pictures that do not carry the mark, held against its record: does any claim, is any taken for the asset?

Of `pictures` in all a quarter each show the asset itself unmarked, which is to be recognised and not claimed; the next
scene, marked under another key; synthetic lumps; and photographs in which nothing was rendered.
"""

from collections.abc import Iterator
from itertools import islice

import cv2
import numpy as np
from skimage import data

from engine.flows.embed.profiles import profile as named_profile
from engine.flows.verify.search import VerifyConfig, verify_images
from engine.flows.views.camera_rig import UP, direction, measure_extent
from engine.lab.evaluate.bench.attacks import claim_row
from engine.lab.evaluate.marked_scene import mark_scene
from engine.lab.evaluate.strangers import PHOTOS, make_stranger
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import image_attack
from engine.model import Float32, GaussianModel, look_at
from engine.raster import render_depth

SIZES = ((1280, 720), (960, 760), (540, 960))
"""Width and height, pixels."""


def posted_pictures(model: GaussianModel, count: int, rng: np.random.Generator) -> Iterator[Float32]:
    """JPEG 80 files (H, W, 3) of any view, roll and background, a quarter of them mirrored."""
    extent = measure_extent(model)
    flat = extent.axes[1] <= 0.2 * max(extent.axes[0], extent.axes[2])  # seen from the air, as it was captured
    for _ in range(count):
        width, height = SIZES[int(rng.integers(len(SIZES)))]
        lens = np.radians(rng.uniform(30.0, 75.0))
        toward = direction(
            rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(20.0, 75.0) if flat else rng.uniform(-5.0, 60.0))
        )
        distance = extent.radius / np.sin(0.5 * lens) / np.exp(rng.uniform(np.log(0.6), np.log(2.0)))
        target = extent.center + 0.2 * extent.radius * rng.normal(size=3)
        roll = rng.uniform(-np.pi, np.pi)
        up = UP * np.cos(roll) + np.cross(toward, UP) * np.sin(roll)
        focal = 0.5 * min(width, height) / np.tan(0.5 * lens)
        camera = look_at(target + distance * toward, target, up, focal, width, height)
        image, alpha, _ = render_depth(model, camera)
        behind = rng.uniform(0, 1, 3) * rng.uniform(0.3, 1.0, (height, 1, 1))
        picture = np.clip(image + (1.0 - alpha[..., None]) * behind, 0.0, 1.0).astype(np.float32)
        picture = picture[:, ::-1] if rng.random() < 0.25 else picture
        yield image_attack("jpeg").apply(np.ascontiguousarray(picture), 80)


PICTURES_OF_A_LUMP = 5


def measure_foreign(scene: str, seed: int, profile: str, pictures: int, other: str | None) -> list[Row]:
    """A row a picture; without another scene a third each of the rest."""
    marked = mark_scene(scene, named_profile(profile), seed=seed)
    rng = np.random.default_rng((seed, 0xF0))
    shown = {"unmarked": posted_pictures(marked.original, pictures, rng)}
    if other is not None:
        config = named_profile(profile, landmark_views=0)
        shown["another scene"] = posted_pictures(mark_scene(other, config, seed=seed + 1).marked, pictures, rng)
    shown |= {"a lump": _lumps(seed, rng), "a photograph": _photographs(rng)}
    each = -(-pictures // len(shown))
    rows: list[Row] = []
    for source, supply in shown.items():
        for number, picture in enumerate(islice(supply, each)):
            result = verify_images([picture], marked.opened, VerifyConfig())
            about = {"source": source, "number": number, "recognised": result.claim.derivation.derived}
            rows.append({"scene": marked.name, **about, **claim_row(source, result)})
    return rows


def _lumps(seed: int, rng: np.random.Generator) -> Iterator[Float32]:
    number = 0
    while True:
        lump: GaussianModel = make_stranger(2_000_000 + 1_000 * seed + number)
        yield from posted_pictures(lump, PICTURES_OF_A_LUMP, rng)
        number += 1


def _photographs(rng: np.random.Generator) -> Iterator[Float32]:
    """Parts of the photographs that scikit-image ships, at the sizes and roll of other pictures, JPEG 80."""
    while True:
        photo = np.atleast_3d(getattr(data, PHOTOS[int(rng.integers(len(PHOTOS)))])())
        photo = np.broadcast_to(photo, (*photo.shape[:2], 3)).astype(np.float32) / 255.0
        width, height = SIZES[int(rng.integers(len(SIZES)))]
        scale = max(width / photo.shape[1], height / photo.shape[0]) * rng.uniform(1.0, 2.0)
        around = cv2.getRotationMatrix2D((photo.shape[1] / 2, photo.shape[0] / 2), rng.uniform(-180.0, 180.0), scale)
        around[:, 2] += np.array([width - photo.shape[1], height - photo.shape[0]]) / 2
        turned = cv2.warpAffine(photo, around, (width, height), borderMode=cv2.BORDER_REFLECT_101)
        yield image_attack("jpeg").apply(np.asarray(turned, dtype=np.float32), 80)
