"""A picture with texture at every scale, a weak keyed pattern on it, and what happens to pictures."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cache

import numpy as np
from PIL import Image
from scipy import ndimage

from engine.lab.sim.attacks import image_attack

BLOCK = 5
SIDE = 300


@cache
def picture(seed: int = 0, side: int = SIDE) -> np.ndarray:
    """Shapes with sharp and soft edges, (side, side, 3), values 0.05 to 0.85."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side]
    image = np.full((side, side, 3), 0.35)
    for _ in range(160):
        cx, cy, radius = *rng.uniform(0, side, 2), rng.uniform(3, 40)
        angle, ratio = rng.uniform(0, np.pi), rng.uniform(0.3, 1)
        u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
        v = -(x - cx) * np.sin(angle) + (y - cy) * np.cos(angle)
        cover = 1 / (1 + np.exp(np.clip((np.hypot(u, v / ratio) - radius) / rng.uniform(0.5, 2), -30, 30)))
        image += cover[..., None] * (rng.uniform(0.05, 0.85, 3) - image)
    for sigma, strength in ((1.0, 0.03), (3.0, 0.03)):
        grain = ndimage.gaussian_filter(rng.normal(size=(side, side)), sigma)
        image += (strength * grain / grain.std())[..., None]
    return np.clip(image, 0.02, 0.9).astype(np.float32)


@dataclass(frozen=True)
class Marked:
    """A picture with keyed signs on square blocks, and how the signs are read back."""

    plain: np.ndarray
    image: np.ndarray
    chips: np.ndarray

    def read(self, cotangent: np.ndarray) -> np.ndarray:
        """Sum of a cotangent over each block: what the rasterizer's VJP and the cells do for a model."""
        n = len(self.plain) // BLOCK
        return cotangent.sum(axis=2, dtype=np.float64).reshape(n, BLOCK, n, BLOCK).sum(axis=(1, 3)).ravel()


@cache
def marked(seed: int = 0, amplitude: float = 0.005) -> Marked:
    """About 46 dB."""
    plain = picture(seed)
    n = len(plain) // BLOCK
    chips = np.random.default_rng(100 + seed).choice([-1.0, 1.0], n * n)
    pattern = np.kron(chips.reshape(n, n), np.ones((BLOCK, BLOCK)))[..., None]
    return Marked(plain, np.clip(plain + amplitude * pattern, 0, 1).astype(np.float32), chips)


def z_score(y: np.ndarray, chips: np.ndarray) -> float:
    """The claim's statistic, DESIGN 4.9."""
    return float(y @ chips / max(float(np.linalg.norm(y)), 1e-30))


def turn(degrees: float) -> np.ndarray:
    """Pixel matrix of the attack `rotate_image`: counter-clockwise about the middle."""
    a, c = np.radians(degrees), SIDE / 2
    about = np.array([[1, 0, c], [0, 1, c], [0, 0, 1.0]])
    spin = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return np.asarray(about @ spin @ np.linalg.inv(about))


def attack(name: str, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The attacked picture, and the true matrix from reference pixel to its pixel."""
    rng = np.random.default_rng(7)
    size = np.eye(3)

    def run(attack: str, image: np.ndarray, strength: float) -> np.ndarray:
        return image_attack(attack).apply(image, strength, rng=rng)

    match name:
        case "none":
            return image, size
        case "jpeg10":
            return run("jpeg", image, 10), size
        case "jpeg50":
            return run("jpeg", image, 50), size
        case "noise 0.1":
            return run("noise_image", image, 0.1), size
        case "noise 0.01":
            return run("noise_image", image, 0.01), size
        case "blur 1":
            return run("blur", image, 1.0), size
        case "brightness 0.5":
            return run("brightness", image, 0.5), size
        case "brightness 1.5":
            return run("brightness", image, 1.5), size
        case "rotation 30":
            return run("rotate_image", image, 30.0), turn(30.0)
        case "scale 0.75":
            return run("scale_image", image, 0.75), np.diag([0.75, 0.75, 1])
        case "scale 1.5":
            return run("scale_image", image, 1.5), np.diag([1.5, 1.5, 1])
        case "squeezed":
            import cv2

            small = cv2.resize(image, (SIDE, 240), interpolation=cv2.INTER_AREA)
            return small, np.diag([1.0, 0.8, 1])
        case "crop":
            return np.ascontiguousarray(image[40:270, 25:255]), np.array([[1, 0, -25], [0, 1, -40], [0, 0, 1.0]])
        case "rotation, scale, jpeg50":
            turned = run("scale_image", run("rotate_image", image, -17.0), 0.8)
            return run("jpeg", turned, 50), np.diag([0.8, 0.8, 1]) @ turn(-17.0)
        case "rotation, noise 0.1":
            return run("noise_image", run("rotate_image", image, 10.0), 0.1), turn(10.0)
    raise ValueError(name)


def coarse_picture(seed: int = 0, size: int = 160) -> np.ndarray:
    """A smooth, colourful picture away from black and white."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0.2, 0.8, (size // 7, size // 7, 3))
    big = np.asarray(Image.fromarray((coarse * 255).astype(np.uint8)).resize((size, size), Image.Resampling.BICUBIC))
    return (big / 255.0 + 0.02 * rng.standard_normal((size, size, 3))).clip(0.05, 0.95).astype(np.float32)


def saved(image: np.ndarray, quality: int, kind: str = "JPEG") -> np.ndarray:
    """What a coder leaves of a picture."""
    buffer = io.BytesIO()
    Image.fromarray((image * 255 + 0.5).astype(np.uint8)).save(buffer, kind, quality=quality)
    return (np.asarray(Image.open(buffer).convert("RGB")) / 255.0).astype(np.float32)
