"""A LiDAR that scans a Gaussian model: ranges and colors by the rasterizer, along a path."""

from dataclasses import dataclass

import numpy as np

from engine.errors import InputError
from engine.lab.points.cloud import PointCloud
from engine.lab.points.trajectory import Trajectory
from engine.lab.sim.capture.scans import Scan
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.raster import prepare_view, sh_colors

_FACES = 4  # pictures around the scanner, a quarter turn each
FINER, MOST_FOCAL = 3.0, 1000.0  # pixels of a picture a beam, and the longest focal length of one, pixels
LUMA = (0.299, 0.587, 0.114)  # of red, green and blue (BT.601)
SOLID = 0.5  # accumulated opacity at which light comes back

MIXED = 0.06
"""Standard deviation of the depth under a beam, part of the depth, beyond which no range is measured: the beam meets
two surfaces, and their mean lies in the air between them."""


@dataclass(frozen=True)
class Lidar:
    """A spinning scanner; its frame is x forward, y left, z up."""

    rings: int = 64  # beams one above the other, evenly between the elevations
    columns: int = 720  # beams a turn
    lowest: float = -40.0  # elevation of the outermost beams, degrees, within +-60
    highest: float = 30.0
    nearest: float = 0.05  # ranges it can measure, scene units
    farthest: float = 100.0
    noise: float = 0.0  # standard deviation of a range, scene units

    def __post_init__(self) -> None:
        if not (2 <= self.rings <= 1024 and 8 <= self.columns <= 8192):
            raise InputError(f"a LiDAR has 2 to 1024 rings and 8 to 8192 columns, got {self.rings}, {self.columns}")
        if not -60.0 <= self.lowest < self.highest <= 60.0:
            raise InputError(f"elevations {self.lowest} to {self.highest} must rise within +-60 degrees")
        if not (0.0 < self.nearest < self.farthest and self.noise >= 0.0):
            limits = f"{self.nearest}, {self.farthest}, {self.noise}"
            raise InputError(f"nearest, farthest and noise must be positive lengths in order, got {limits}")

    @property
    def directions(self) -> Float64:
        """(columns, rings, 3) unit vectors of the beams, in the order they are sent."""
        azimuth = 2.0 * np.pi * (np.arange(self.columns) + 0.5) / self.columns
        elevation = np.radians(np.linspace(self.lowest, self.highest, self.rings))
        a, e = np.meshgrid(azimuth, elevation, indexing="ij")
        return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)


def scan_model(model: GaussianModel, trajectory: Trajectory, lidar: Lidar = Lidar(), *, seed: int = 0) -> list[Scan]:
    """Scan a model from every pose of a trajectory, each scan taken at once.

    A beam goes through the nearest pixel of a picture three times as fine as the beams are, so that its range and
    direction belong together exactly. Scans hold colored points in the scanner's frame, of those beams that came back
    (InputError where none did); intensity is the luminance.
    """
    rng = np.random.default_rng(seed)
    beams = lidar.directions.reshape(-1, 3)
    scans = []
    for k, pose in enumerate(trajectory.matrices):
        found = [_face(model, pose, beams, lidar, face) for face in range(_FACES)]
        points, colors = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if len(points) == 0:
            raise InputError(f"no beam of the scan at pose {k} met anything within {lidar.farthest:g}")
        ranges = np.linalg.norm(points, axis=1, keepdims=True)
        points = points * (1.0 + lidar.noise * rng.standard_normal(ranges.shape) / ranges)
        time = None if trajectory.times is None else float(trajectory.times[k])
        shades = colors.astype(np.float32)
        luminance = shades @ np.array(LUMA, dtype=np.float32)
        scans.append(Scan(PointCloud(points, shades, luminance), f"scan {k}", time))
    return scans


def _face(model: GaussianModel, pose: Float64, beams: Float64, lidar: Lidar, face: int) -> tuple[Float64, Float64]:
    """Points (scanner's frame) and colors of the beams within 45 degrees of a quarter's middle."""
    middle = 0.5 * np.pi * face
    c, s = np.cos(middle), np.sin(middle)
    to_camera = np.array([[s, -c, 0.0], [0.0, 0.0, -1.0], [c, s, 0.0]])  # x right, y down, z forward
    seen = beams @ to_camera.T  # (B, 3)
    azimuth = np.arctan2(seen[:, 0], seen[:, 2])
    seen = seen[(azimuth >= -0.25 * np.pi) & (azimuth < 0.25 * np.pi)]
    slope = seen[:, :2] / seen[:, 2:]  # (b, 2) of the beams that this picture shows
    focal = FINER * max(lidar.columns / (2.0 * np.pi), lidar.rings / np.radians(lidar.highest - lidar.lowest))
    focal = min(focal, MOST_FOCAL)
    low, high = slope.min(axis=0), slope.max(axis=0)
    width, height = (int(np.ceil(focal * span)) + 2 for span in high - low)
    K = np.array([[focal, 0.0, 1.0 - focal * low[0]], [0.0, focal, 1.0 - focal * low[1]], [0.0, 0.0, 1.0]])
    viewmat = np.eye(4)
    viewmat[:3, :3] = to_camera @ pose[:3, :3].T
    viewmat[:3, 3] = -viewmat[:3, :3] @ pose[:3, 3]
    image, alpha, depth, thickness = _draw(model, Camera(viewmat, K, width, height))
    pixel = np.floor(slope * focal + K[:2, 2]).astype(int)
    column, row = np.clip(pixel[:, 0], 0, width - 1), np.clip(pixel[:, 1], 0, height - 1)
    ray = np.stack([(column + 0.5 - K[0, 2]) / focal, (row + 0.5 - K[1, 2]) / focal, np.ones(len(row))], axis=1)
    points = ray * depth[row, column][:, None].astype(np.float64)
    ranges = np.linalg.norm(points, axis=1)
    back = (alpha[row, column] >= SOLID) & (ranges >= lidar.nearest) & (ranges <= lidar.farthest)
    back &= thickness[row, column] <= MIXED * depth[row, column]
    shades = np.clip(image[row, column] / np.maximum(alpha[row, column], SOLID)[:, None], 0.0, 1.0)
    return points[back] @ to_camera, shades[back].astype(np.float64)


def _draw(model: GaussianModel, camera: Camera) -> tuple[Float32, Float32, Float32, Float32]:
    """Image (H, W, 3), opacity, mean depth and its standard deviation (H, W), scene units."""
    view = prepare_view(model, camera)
    row = camera.viewmat[2]
    depths = (model.means @ row[:3].astype(np.float32) + np.float32(row[3])).astype(np.float32)[:, None]
    near = np.float32(np.median(depths[view.visible])) if len(view.visible) else np.float32(0.0)
    colors = sh_colors(model.sh, model.means, camera.position)
    image, alpha = view.render(colors)
    far, _ = view.render(np.concatenate([depths - near, (depths - near) ** 2], axis=1))
    solid = np.maximum(alpha, np.float32(SOLID))
    mean, square = far[..., 0] / solid, far[..., 1] / solid
    spread: Float32 = np.sqrt(np.maximum(square - mean**2, np.float32(0.0)))
    return image, alpha, (mean + near).astype(np.float32), spread
