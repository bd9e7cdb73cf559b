"""Steps of devices that look at a model or keep it: a LiDAR scans it, a viewer shows less of it, in half precision."""

from dataclasses import dataclass

import numpy as np

from engine.compress.levels_of_detail import merge_pairs
from engine.errors import InputError
from engine.flows.views.camera_rig import UP, Extent, direction, measure_extent
from engine.lab.points.trajectory import Trajectory
from engine.lab.sim.attack_cost import model_cost
from engine.lab.sim.capture.lidar import Lidar, scan_model
from engine.lab.sim.capture.pose_estimation import odometry
from engine.lab.sim.capture.scans import scans_to_model
from engine.lab.sim.scenario.state import Advance, Outcome, StepKind, World, step
from engine.lab.sim.scenario.tables import Table, given
from engine.lab.sim.scenario.theft_steps import COST_SIZE, COST_VIEWS
from engine.model import ATTRIBUTES, Float64, GaussianModel
from engine.numerics.similarity import rotation_to_quaternion, transform_model

KINDS: dict[str, StepKind] = {}

AROUND, INSIDE = 2.0, 0.3  # radii from the middle at which the scanner goes round an object, or within a room
LOWEST, HIGHEST = -5.0, 35.0  # elevations between which it goes up and down on its way, degrees
FARTHEST = 10.0  # range of the scanner, radii
LARGEST_HALF = float(np.finfo(np.float16).max)


def scanning_path(extent: Extent, stops: int) -> Trajectory:
    """The way of a scanner, level, its x axis towards the middle: around an object, or within a room."""
    positions, turns = [], []
    for k in range(stops):
        elevation = LOWEST + (HIGHEST - LOWEST) * 0.5 * (1.0 - np.cos(2.0 * np.pi * k / stops))
        toward = direction(2.0 * np.pi * k / stops, np.radians(0.0 if extent.is_room else elevation))
        positions.append(extent.center + (INSIDE if extent.is_room else AROUND) * extent.radius * toward)
        forward = -toward + (toward @ UP) * UP
        forward /= np.linalg.norm(forward)
        turns.append(np.stack([forward, np.cross(UP, forward), UP], axis=1))  # x forward, y left, z up
    times: Float64 = np.arange(stops, dtype=np.float64)
    return Trajectory(np.array(positions), rotation_to_quaternion(np.array(turns)), times)


@step(KINDS, "scan", "a LiDAR goes round; its points become the model: stops, rings, columns, noise, odometry, on")
@dataclass(frozen=True)
class Scan:
    """What a scanner sees in place of the model. `noise` of a range in radii; with `odometry` its path is not known,
    but found from the scans (extra `capture`)."""

    stops: int = given(Table.integer, 12, 2, 1000)
    rings: int = given(Table.integer, 256, 2, 1024)
    columns: int = given(Table.integer, 1800, 8, 8192)
    noise: float = given(Table.number, 0.0, 0.0, 1.0)
    odometry: bool = given(Table.flag, False)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        extent = measure_extent(model)
        path = scanning_path(extent, self.stops)
        lidar = Lidar(
            rings=self.rings,
            columns=self.columns,
            lowest=-55.0,
            highest=40.0,
            nearest=0.01 * extent.radius,
            farthest=FARTHEST * extent.radius,
            noise=self.noise * extent.radius,
        )
        scans = scan_model(model, path, lidar, seed=int(rng.integers(2**31)))
        advance(0.5)
        notes = []
        if self.odometry:
            found = _anchored(odometry(scans), path)
            off = np.linalg.norm(found.positions - path.positions, axis=1) / extent.radius
            notes.append(f"odometry: path off by {100.0 * float(np.sqrt((off**2).mean())):.1f} % of the radius (RMS)")
            path = found
        made = scans_to_model(scans, path)
        seen = transform_model(made.model, 1.0, np.eye(3), made.origin)
        notes.append(f"{made.points_read} points in {len(scans)} scans, {len(seen)} Gaussians of them")
        cost = model_cost(model, seen, views=COST_VIEWS, size=COST_SIZE)
        return Outcome(world.put(name, seen), notes=tuple(notes), cost=cost)


def _anchored(found: Trajectory, path: Trajectory) -> Trajectory:
    """A path in the frame of its first pose, with that pose where the true one is: odometry knows no more."""
    matrices = path.matrices[0] @ np.linalg.inv(found.matrices[0]) @ found.matrices
    return Trajectory(matrices[:, :3, 3], rotation_to_quaternion(matrices[:, :3, :3]), path.times)


@step(KINDS, "level", "a level of detail as `mark3dgs convert` makes them: share, on")
@dataclass(frozen=True)
class Level:
    """Neighbors merged, pair after pair, until a share of the Gaussians is left."""

    share: float = given(Table.number, 0.25, 1e-6, 1.0)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        level = merge_pairs(model, self.share, surface=True)
        cost = model_cost(model, level, views=COST_VIEWS, size=COST_SIZE)
        return Outcome(world.put(name, level), notes=(f"{len(level)} of {len(model)} Gaussians",), cost=cost)


@step(KINDS, "float16", "a viewer keeps it in half precision: on")
@dataclass(frozen=True)
class Float16:
    """Every value rounded to float16 and back."""

    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        half = half_precision(model)
        cost = model_cost(model, half, views=COST_VIEWS, size=COST_SIZE)
        return Outcome(world.put(name, half), cost=cost)


def half_precision(model: GaussianModel) -> GaussianModel:
    """Every value rounded to float16 and back, quaternions brought to unit length again.

    No file format read here holds half floats (SPZ and SOG quantize in their own way): this is what happens in graphics
    memory, and in files of viewers that dump it. Centers keep 11 bits, so that a scene far from its origin shows steps.
    InputError if a center or a coefficient is too large for float16 (65,504).
    """
    for name in ("means", "sh"):
        array = getattr(model, name)
        rows = np.flatnonzero((np.abs(array) > LARGEST_HALF).reshape(len(array), -1).any(axis=1))
        if len(rows):
            raise InputError(f"{name}: row {rows[0]} is too large for float16: {array[rows[0]].tolist()}")
    half = model.with_(**{name: getattr(model, name).astype(np.float16) for name in ATTRIBUTES})
    quats = half.quats.astype(np.float64)
    return half.with_(quats=quats / np.linalg.norm(quats, axis=1, keepdims=True))
