"""From photos and their COLMAP reconstruction to a trained Gaussian model; lens distortion is undone first."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.errors import CameraError, InputError
from engine.flows.progress import Clock, Progress
from engine.formats.cameras.colmap import PosedPhoto
from engine.formats.cameras.fisheye import FisheyeCamera
from engine.lab.points.reconstruction import Reconstruction, read_reconstruction
from engine.lab.sim.capture.capture_kernels import kernels_from_points
from engine.lab.sim.capture.trainer import TrainConfig, Trainer
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render

_MAX_ZOOM = 4.0
_ZOOM_TOLERANCE = 1e-4
_ASPECT_TOLERANCE = 0.01
_RADII = 64  # places between middle and border at which a lens polynomial must still rise


def read_photo(folder: str | os.PathLike[str], photo: PosedPhoto) -> npt.NDArray[np.uint8]:
    """(H, W, 3) pixels of a photo of a reconstruction in the photos' folder, which its name must not lead out of.

    As stored: structure from motion does not turn photos by their EXIF entry either.
    """
    from PIL import Image

    root = Path(folder).resolve()
    path = (root / photo.name.replace("\0", "?")).resolve()
    if not path.is_relative_to(root):
        raise InputError(f"photo {photo.name!r} of the reconstruction lies outside {folder}")
    try:
        with Image.open(path) as picture:
            pixels = np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: cannot be read as a picture: {error}") from None
    height, width = pixels.shape[:2]
    camera = photo.camera
    if abs(width * camera.height / (height * camera.width) - 1.0) > _ASPECT_TOLERANCE:
        raise InputError(f"{path}: is {width}x{height}, its camera {camera.width}x{camera.height}")
    return pixels


def undistort(pixels: npt.NDArray[np.uint8], photo: PosedPhoto, size: int | None = None) -> tuple[Camera, Float32]:
    """A photo as a pinhole camera at its place would have taken it.

    The focal length grows just as far as is needed to leave no empty border; CameraError if the lens bends so strongly
    that no pinhole picture fits into the photo. `pixels` (H, W, 3) are the photo or a smaller copy of it; the image
    (H, W, 3), 0 to 1, has a longest side of `size` pixels, but is never larger than the photo.
    """
    import cv2  # a heavy import that only image work pays for

    if size is not None and size < 1:
        raise InputError(f"size is {size}, expected at least 1 pixel")
    height, width = pixels.shape[:2]
    camera = photo.camera.resized(width, height)
    if isinstance(photo.camera, FisheyeCamera):
        pixels, camera = photo.camera.undistort(pixels)
    if any(photo.distortion):
        zoom = _zoom(camera, photo)
        new = camera.K.copy()
        new[0, 0] *= zoom
        new[1, 1] *= zoom
        maps = cv2.initUndistortRectifyMap(
            _opencv(camera.K), np.array(photo.distortion), None, _opencv(new), (width, height), cv2.CV_32FC1
        )
        pixels = cv2.remap(pixels, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        camera = Camera(camera.viewmat, new, width, height)
    image = pixels.astype(np.float32) / np.float32(255.0)
    factor = min(1.0, size / max(width, height)) if size is not None else 1.0
    if factor < 1.0:
        small = max(1, round(width * factor)), max(1, round(height * factor))
        image = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
        camera = camera.resized(*small)
    return camera, np.ascontiguousarray(image, dtype=np.float32)


def _opencv(K: Float64) -> Float64:
    """Intrinsics in OpenCV's pixels, whose centers lie at whole numbers."""
    moved = K.copy()
    moved[:2, 2] -= 0.5
    return moved


def _zoom(camera: Camera, photo: PosedPhoto) -> float:
    """Smallest factor >= 1 on the focal length at which the whole picture comes from inside the photo."""
    if _inside(camera, photo, 1.0):
        return 1.0
    low, high = 1.0, _MAX_ZOOM
    if not _inside(camera, photo, high):
        raise CameraError(f"photo {photo.name!r}: distortion {photo.distortion} is too strong to be undone")
    while high - low > _ZOOM_TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _inside(camera, photo, middle) else (middle, high)
    return high


def _inside(camera: Camera, photo: PosedPhoto, zoom: float) -> bool:
    """Do all pixels of the border of the zoomed picture come from inside the photo, and none from the far side of
    a lens polynomial that has turned back?"""
    w, h = camera.width, camera.height
    x, y = np.arange(w) + 0.5, np.arange(h) + 0.5
    border = np.concatenate(
        [np.stack([x, np.full(w, v)], 1) for v in (0.5, h - 0.5)]
        + [np.stack([np.full(h, u), y], 1) for u in (0.5, w - 0.5)]
    )
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    a, b = (border[:, 0] - cx) / (fx * zoom), (border[:, 1] - cy) / (fy * zoom)
    k1, k2, p1, p2 = photo.distortion
    r2 = a * a + b * b
    radial = 1.0 + k1 * r2 + k2 * r2 * r2
    u = fx * (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)) + cx
    v = fy * (b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b) + cy
    outward = np.linspace(0.0, 1.0, _RADII)[:, None] * r2
    rising = 1.0 + 3.0 * k1 * outward + 5.0 * k2 * outward * outward > 0.0
    return bool(((u >= 0) & (u <= w) & (v >= 0) & (v <= h)).all() and rising.all())


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """Undistorted photos (H, W, 3), and the numbers of those held out."""

    names: list[str]
    cameras: list[Camera]
    images: list[Float32]
    held_out: list[int]

    @property
    def trained_on(self) -> list[int]:
        """The others."""
        return [k for k in range(len(self.names)) if k not in self.held_out]


@dataclass(frozen=True, eq=False)
class Capture:
    """A model trained on photos."""

    model: GaussianModel
    photos: PhotoSet
    psnr: list[float]  # dB, of the renders against each photo; a random background counts as black
    steps_per_second: float

    @property
    def psnr_trained(self) -> float:
        """Mean over the photos trained on, dB."""
        return float(np.mean([self.psnr[k] for k in self.photos.trained_on]))

    @property
    def psnr_held_out(self) -> float | None:
        """Mean over the photos held out, dB; None where there are none."""
        return float(np.mean([self.psnr[k] for k in self.photos.held_out])) if self.photos.held_out else None


def load_photos(
    reconstruction: Reconstruction,
    images: str | os.PathLike[str],
    *,
    size: int = 800,
    hold_out: int = 8,
    clock: Clock | None = None,
) -> PhotoSet:
    """Read the photos of a reconstruction from a folder and undistort them, at most `size` pixels on the longest side.

    By the order of the names, the middle one of every `hold_out` photos is held out, so that it has trained neighbors
    on both sides; 0 holds none out.
    """
    photos = reconstruction.photos
    if hold_out < 0 or hold_out == 1:
        raise InputError(f"hold_out is {hold_out}, expected 0 (none) or at least 2")
    held = [k for k in range(len(photos)) if hold_out and k % hold_out == hold_out // 2]
    if len(photos) - len(held) < 2:
        raise InputError(f"{len(photos)} photos, {len(held)} of them held out, are too few to train on")
    cameras, pictures = [], []
    for k, photo in enumerate(photos):
        camera, picture = undistort(read_photo(images, photo), photo, size)
        cameras.append(camera)
        pictures.append(picture)
        if clock is not None:
            clock.advance((k + 1) / len(photos))
    return PhotoSet([photo.name for photo in photos], cameras, pictures, held)


def train_from_colmap(
    folder: str | os.PathLike[str],
    images: str | os.PathLike[str],
    *,
    size: int = 800,
    hold_out: int = 8,
    config: TrainConfig | None = None,
    progress: Progress | None = None,
) -> Capture:
    """Train a model on the photos of a COLMAP model in a folder, see `read_reconstruction` and `load_photos`.

    Progress has the stages "photos", "train" and "compare".
    """
    config = config or TrainConfig()
    clock = Clock(progress)
    reconstruction = read_reconstruction(folder)
    with clock.stage("photos"):
        photos = load_photos(reconstruction, images, size=size, hold_out=hold_out, clock=clock)
    start = kernels_from_points(reconstruction.points.positions, reconstruction.points.colors)
    used = photos.trained_on
    trainer = Trainer(start, [photos.cameras[k] for k in used], [photos.images[k] for k in used], config)
    with clock.stage("train"):
        model = trainer.run(clock.advance)
    with clock.stage("compare"):
        behind = 0.0 if isinstance(config.background, str) else config.background
        pairs = zip(photos.cameras, photos.images, strict=True)
        quality = [psnr(render(model, camera, behind), image) for camera, image in pairs]
    return Capture(model, photos, quality, config.steps / clock.seconds["train"])
