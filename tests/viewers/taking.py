"""Pictures as people take them: any viewer, view, background, tone curve, roll and file, drawn from a seed."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from engine.flows.views.camera_rig import UP, direction, measure_extent
from engine.lab.evaluate.bench.attacks import photograph
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.numerics.resampling import resized
from engine.pictures.camera.camera_motion import project
from engine.raster import render_depth
from tests.pictures.rolling import rolled
from tests.viewers.shooting import Studio

PHOTOS = Path(__file__).parents[3] / "shared/data/posed/lund_door/images"
SIZES = {"landscape": (1280, 720), "window": (960, 760), "portrait": (540, 960)}
BACKGROUNDS = ("black", "grey", "white", "gradient", "photo")
TONES = ("none", "none", "aces", "filmic", "neutral")
ROLLS = ("upright", "upright", "tilted", "quarter", "over")
"""Turned by up to 15 degrees, by a quarter left or right, or by half a turn."""
COUNTS = 0.2
"""Share of the asset that a picture shows, and of itself that it fills, from which on it counts."""
FILES = ("png", "jpeg 80", "webp 75", "recorded")
"""Recorded: a frame of a film of it (H.264, as OBS records)."""
POSTED_SIDE = 640
"""Longer side of a picture that was made smaller to be posted, pixels."""


@dataclass(frozen=True, eq=False)
class Taken:
    """A picture, and how it was taken."""

    picture: Float32  # (H, W, 3), 0 to 1
    camera: Camera  # in the model's frame, before the picture was mirrored
    tags: dict[str, str] = field(default_factory=dict)
    seen: float = 0.0  # share of the asset's visible surface that lies in the picture
    filled: float = 0.0  # share of the picture that it fills

    @property
    def counts(self) -> bool:
        """Whether at least a fifth of the asset fills at least a fifth of the picture."""
        return min(self.seen, self.filled) >= COUNTS

    def as_file(self, kind: str) -> Taken:
        """This picture as read from a file of a kind, what was done before it was posted in front: "small, jpeg 70"."""
        change, _, file = kind.rpartition(", ")
        picture = filed(POSTED[change](self.picture) if change else self.picture, file)
        return replace(self, picture=picture, tags=self.tags | {"file": kind})


def random_camera(
    model: GaussianModel, rng: np.random.Generator, size: tuple[int, int], roll: str
) -> tuple[Camera, float]:
    """A camera around the asset (in it, where it is a room), from near to far; and how far that is, scene units."""
    width, height = size
    extent = measure_extent(model)
    field_of_view = np.radians(rng.uniform(30.0, 75.0))  # of the shorter side
    focal = 0.5 * min(width, height) / np.tan(0.5 * field_of_view)
    flat = extent.axes[1] <= 0.2 * max(extent.axes[0], extent.axes[2])
    elevation = np.radians(rng.uniform(20.0, 75.0) if flat else rng.uniform(-5.0, 60.0))
    toward = direction(rng.uniform(0.0, 2.0 * np.pi), elevation)
    if extent.is_room:
        eye = extent.center - rng.uniform(0.1, 0.3) * extent.radius * toward
        distance = extent.radius
        target = extent.center + distance * toward
    else:
        target = extent.center + 0.25 * extent.radius * rng.normal(size=3) * (1.0, 0.5, 1.0)
        # At a zoom of 1 the asset's sphere fills the shorter side.
        distance = extent.radius / np.sin(0.5 * field_of_view) / np.exp(rng.uniform(np.log(0.6), np.log(2.0)))
        eye = target + distance * toward
    lean = {"upright": 0.0, "tilted": rng.uniform(-15.0, 15.0), "quarter": rng.choice([-90.0, 90.0]), "over": 180.0}
    camera = look_at(eye, target, UP, focal, width, height)
    return rolled(camera, np.radians(lean[roll])), float(distance)


def coverage(model: GaussianModel, camera: Camera) -> tuple[float, float]:
    """Share of the asset's surface within the picture's frame, and share of the picture that it fills."""
    extent = measure_extent(model)
    near = np.linalg.norm(model.means - extent.center, axis=1) < 1.5 * extent.radius
    log_area = np.sort(model.log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    weight = model.opacities * np.exp(np.minimum(log_area, np.quantile(log_area, 0.95))) * near
    places = project(model.means.astype(np.float64), camera)
    inside = ((places >= 0) & (places < (camera.width, camera.height))).all(axis=1)
    _, alpha, _ = render_depth(model, camera.with_side(320))
    return float((weight * inside).sum() / weight.sum()), float((alpha > 0.5).mean())


def take(
    studio: Studio,
    model: GaussianModel,
    file: str,
    seed: tuple[int, ...],
    kind: str = "supersplat",
    least: float = 0.05,
) -> Taken:
    """One picture of a model file in the studio's folder, not yet a file, everything drawn from the seed; at `least`
    this share of the asset is seen, and fills the picture, where a camera of 50 does that."""
    rng = np.random.default_rng(seed)
    tags = {
        "viewer": kind,
        "size": str(rng.choice(list(SIZES))),
        "background": str(rng.choice(BACKGROUNDS)),
        "tone": str(rng.choice(TONES)) if kind == "supersplat" else "none",
        "roll": str(rng.choice(ROLLS)),
        "file": str(rng.choice(FILES)),
        "interface": str(rng.choice(["with", "without"])) if kind == "supersplat" else "without",
        "antialiasing": str(rng.choice(["off", "on"])) if kind == "supersplat" else "off",
        "hand": str(rng.choice(["right", "right", "right", "mirrored"])),
    }
    size = SIZES[tags["size"]]
    for _ in range(50):
        camera, distance = random_camera(model, rng, size, tags["roll"])
        seen, filled = coverage(model, camera)
        if min(seen, filled) >= least:
            break
    options = {"tone": tags["tone"], "ui": tags["interface"] == "with", "aa": tags["antialiasing"] == "on"}
    with studio.viewer(kind, file, size, **options) as viewer:
        shot = viewer.shoot(camera, distance / 100.0, distance * 100.0)
    picture = shot.over(background(tags["background"], rng, size))
    if tags["hand"] == "mirrored":
        picture = np.ascontiguousarray(picture[:, ::-1])
    return Taken(picture, camera, tags, seen, filled)


def background(kind: str, rng: np.random.Generator, size: tuple[int, int]) -> Float32:
    """(H, W, 3) what is seen past the model."""
    width, height = size
    if kind == "photo" and PHOTOS.is_dir():
        photo = Image.open(rng.choice(sorted(PHOTOS.glob("*.*"))))  # type: ignore[arg-type]  # an array of paths
        side = max(width / photo.width, height / photo.height)
        photo = photo.resize((round(photo.width * side) + 1, round(photo.height * side) + 1)).crop(
            (0, 0, width, height)
        )
        return np.asarray(photo.convert("RGB"), dtype=np.float32) / 255.0
    if kind in ("gradient", "photo"):
        top, bottom = rng.random((2, 3)).astype(np.float32)
        down = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None, None]
        return np.broadcast_to((1.0 - down) * top + down * bottom, (height, width, 3))
    level = {"black": 0.0, "grey": 0.35, "white": 1.0}[kind]
    return np.full((height, width, 3), level, dtype=np.float32)


def filed(picture: Float32, kind: str) -> Float32:
    """The picture as read from a file of a kind."""
    image = Image.fromarray(np.round(255.0 * picture).astype(np.uint8))
    if kind == "recorded":
        return _recorded(image)
    stream = BytesIO()
    name, _, quality = kind.partition(" ")
    image.save(stream, name, **({"quality": int(quality)} if quality else {}))
    return np.asarray(Image.open(stream).convert("RGB"), dtype=np.float32) / 255.0


def _small(picture: Float32) -> Float32:
    height, width = picture.shape[:2]
    factor = POSTED_SIDE / max(height, width)
    return np.clip(resized(picture, round(factor * width), round(factor * height)), 0.0, 1.0)


def _captioned(picture: Float32) -> Float32:
    """White letters edged in black, as in the upper and lower tenth of a meme."""
    image = Image.fromarray(np.round(255.0 * picture).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(image.height / 14)
    for down, text in ((0.01, "WHEN THE SCAN"), (0.9, "TURNS OUT FINE")):
        place = (0.5 * image.width, down * image.height)
        draw.text(place, text, "white", font, anchor="ma", stroke_width=3, stroke_fill="black")
    return np.asarray(image, dtype=np.float32) / 255.0


def _portrait(picture: Float32) -> Float32:
    """Cut to 4:5 around the middle."""
    height, width = picture.shape[:2]
    rows, columns = min(height, round(1.25 * width)), min(width, round(0.8 * height))
    top, left = (height - rows) // 2, (width - columns) // 2
    return np.ascontiguousarray(picture[top : top + rows, left : left + columns])


POSTED: dict[str, Callable[[Float32], Float32]] = {
    "small": _small,
    "captions": _captioned,
    "4:5": _portrait,
    "off a screen": lambda picture: photograph(picture, np.random.default_rng(0)),
}
"""What people do with a picture before it becomes a file."""


def _recorded(image: Image.Image) -> Float32:
    with tempfile.TemporaryDirectory() as folder:
        still, film, frame = (Path(folder) / name for name in ("still.png", "film.mp4", "frame.png"))
        image.save(still)
        quiet = ["ffmpeg", "-loglevel", "error", "-y"]
        encode = ["-loop", "1", "-i", still, "-t", "0.4", "-r", "30", "-pix_fmt", "yuv420p", "-c:v", "libx264"]
        subprocess.run([*quiet, *encode, "-crf", "23", film], check=True)
        subprocess.run([*quiet, "-i", film, "-vf", r"select=eq(n\,8)", "-frames:v", "1", frame], check=True)
        return np.asarray(Image.open(frame).convert("RGB"), dtype=np.float32) / 255.0
