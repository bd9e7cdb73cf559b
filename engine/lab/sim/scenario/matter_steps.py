"""Steps in which matter moves: an object falls, is pressed, several collide; the film may show the strain.

A body's robust radius counts as one metre, the whole scene's where several collide, so that everything falls and bends
alike whatever its units are.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import GOLDEN_ANGLE, UP, Extent, measure_extent
from engine.lab.sim.model_placement import join
from engine.lab.sim.physics import world as matter
from engine.lab.sim.physics.body import (
    Body,
    Material,
    color_by_strain,
    kernel_velocities,
    make_body,
    pose,
    strain_norms,
)
from engine.lab.sim.physics.world import energy
from engine.lab.sim.scenario.state import Advance, Outcome, StepKind, World, step
from engine.lab.sim.scenario.tables import Table, given
from engine.model import SH_C0, Float64, GaussianModel
from engine.numerics.similarity import transform_model

KINDS: dict[str, StepKind] = {}

GRAVITY = 9.81
FLOOR_QUANTILE = 0.005  # the floor lies below all but this share of a body's centers: a floater does not hold it up
BALL_GAUSSIANS = 4000
LIGHT = np.array([0.4, -0.8, 0.45])  # where the light comes from by which a ball is drawn


def read_ball(table: Table, name: str) -> tuple[float, ...] | None:
    """Center and radius of a fixed ball, or None where not given."""
    if name not in table:
        return None
    ball = table.vector(name, None, 4)
    if not ball[3] > 0.0:
        raise InputError(f"{table.place}: {name} = [x, y, z, radius] needs a positive radius, got {ball[3]:g}")
    return ball


@dataclass(frozen=True)
class _Simulate(ABC):
    """Bodies of soft matter on a floor, for some seconds; a lid may press them, a ball be in their way."""

    seconds: float = given(Table.number, 1.0, 0.02, 60.0)
    frames: int = given(Table.integer, 24, 0, 1000)
    compliance: float = given(Table.number, 2e-5, 0.0, 1.0)  # 1 / Young's modulus, 1/Pa
    resolution: int = given(Table.integer, 16, 2, 96)  # voxels along the longest side of a body
    ball: tuple[float, ...] | None = given(read_ball)  # fixed: x, y, z and radius, radii about the middle
    strain: bool = given(Table.flag, False)  # whether the film shows strain for color
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        objects, extent = self.involved(world)
        metric = {name: _metric(model, extent) for name, model in objects.items()}
        material = Material(compliance=self.compliance)
        speeds = self.speeds(metric)
        bodies = tuple(
            make_body(model, resolution=self.resolution, material=material, velocity=speeds[name])
            for name, model in metric.items()
        )
        heights = np.concatenate([model.means.astype(np.float64) @ UP for model in metric.values()])
        bottom, top = np.quantile(heights, [FLOOR_QUANTILE, 1.0 - FLOOR_QUANTILE])
        balls = () if self.ball is None else (matter.Sphere(np.array(self.ball[:3]), self.ball[3]),)
        planes = self.planes(float(bottom), float(top))
        state = matter.World(bodies, gravity=-GRAVITY * UP, planes=planes, spheres=balls)
        before = energy(state).total
        steps = max(1, round(self.seconds / matter.STEP))
        shown = set(np.linspace(1, steps, min(self.frames, steps)).round().astype(int).tolist())
        frames, fastest = [], 0.0
        for number in range(1, steps + 1):
            state = matter.step(state)
            if number in shown:
                frames.append(self._shot(world, dict(zip(metric, state.bodies, strict=True)), extent))
                fastest = max(fastest, *(_fastest(body) for body in state.bodies))
            advance(number / steps)
        for name, body in zip(metric, state.bodies, strict=True):
            world = world.put(name, _back(pose(body), extent))
        strains = ", ".join(f"{np.median(strain_norms(body)):.3f}" for body in state.bodies)
        elements = sum(len(body.lattice.tets) for body in bodies)
        lost = f"energy {before:.1f} to {energy(state).total:.1f} J, fastest {fastest:.1f} m/s"
        return Outcome(world, frames=tuple(frames), notes=(f"median strain {strains}, {elements} tetrahedra; {lost}",))

    def involved(self, world: World) -> tuple[Mapping[str, GaussianModel], Extent]:
        """The bodies, and the extent whose radius is a metre."""
        name, model = world.target(self.on)
        return {name: model}, measure_extent(model)

    def speeds(self, metric: Mapping[str, GaussianModel]) -> dict[str, Float64]:
        """(3,) of each body at the start, metres a second."""
        return {name: np.zeros(3) for name in metric}

    @abstractmethod
    def planes(self, bottom: float, top: float) -> tuple[matter.Plane, ...]:
        """The floor, and what else stops bodies that stand between these heights."""

    def _shot(self, world: World, bodies: Mapping[str, Body], extent: Extent) -> GaussianModel:
        """A moment for the film: the whole world, and the ball."""
        draw = color_by_strain if self.strain else pose
        for name, body in bodies.items():
            world = world.put(name, _back(draw(body), extent))
        scene = world.flat()
        return scene if self.ball is None else join(scene, _back(ball_model(self.ball), extent))


def _fastest(body: Body) -> float:
    return float(np.linalg.norm(kernel_velocities(body), axis=1).max(initial=0.0))


def _metric(model: GaussianModel, extent: Extent) -> GaussianModel:
    return transform_model(model, 1.0 / extent.radius, np.eye(3), -extent.center / extent.radius)


def _back(model: GaussianModel, extent: Extent) -> GaussianModel:
    return transform_model(model, extent.radius, np.eye(3), extent.center)


def ball_model(ball: tuple[float, ...]) -> GaussianModel:
    """A grey ball to look at, lit from one side: flat Gaussians on a Fibonacci sphere."""
    from scipy.spatial.transform import Rotation

    k = np.arange(BALL_GAUSSIANS) + 0.5
    z, turn = 1.0 - 2.0 * k / BALL_GAUSSIANS, GOLDEN_ANGLE * k
    across = np.sqrt(1.0 - z * z)
    normals = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)  # (B, 3)
    spacing = ball[3] * np.sqrt(4.0 * np.pi / BALL_GAUSSIANS)
    axis = np.cross([0.0, 0.0, 1.0], normals)
    angle = np.arccos(np.clip(z, -1.0, 1.0))[:, None]
    turns = Rotation.from_rotvec(angle * axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12))
    shade = 0.25 + 0.6 * np.clip(normals @ LIGHT, 0.0, 1.0)
    log_scales = np.log(np.array([0.7, 0.7, 0.05]) * spacing)
    return GaussianModel(
        (np.array(ball[:3]) + ball[3] * normals).astype(np.float32),
        np.tile(log_scales, (BALL_GAUSSIANS, 1)).astype(np.float32),
        np.roll(turns.as_quat(), 1, axis=1).astype(np.float32),
        np.full(BALL_GAUSSIANS, 4.0, np.float32),
        np.repeat(((shade - 0.5) / SH_C0)[:, None, None], 3, axis=2).astype(np.float32),
    )


@step(KINDS, "drop", "it falls as soft matter: height, ball, strain, seconds, frames, compliance, resolution, on")
@dataclass(frozen=True)
class Drop(_Simulate):
    """A fall of `height` radii."""

    height: float = given(Table.number, 0.5, 0.0, 100.0)
    seconds: float = given(Table.number, 1.2, 0.02, 60.0)

    def planes(self, bottom: float, top: float) -> tuple[matter.Plane, ...]:
        return (matter.Plane((bottom - self.height) * UP, UP),)


@step(KINDS, "press", "a lid presses it to a share of its height: share, ball, strain, seconds, frames, compliance, on")
@dataclass(frozen=True)
class Press(_Simulate):
    """A lid that leaves `share` of the height; 1 presses nothing."""

    share: float = given(Table.number, 0.7, 0.1, 1.0)
    seconds: float = given(Table.number, 1.5, 0.02, 60.0)

    def planes(self, bottom: float, top: float) -> tuple[matter.Plane, ...]:
        floor = matter.Plane(bottom * UP, UP)
        if self.share == 1.0:
            return (floor,)
        speed = (1.0 - self.share) * (top - bottom) / self.seconds
        return floor, matter.Plane((top + 0.02) * UP, -UP, -speed * UP)


@step(
    KINDS, "collide", "all objects fly at each other and fall: speed, height, ball, strain, seconds, frames, compliance"
)
@dataclass(frozen=True)
class Collide(_Simulate):
    """Every object is a body of its own, thrown at the middle of them all with `speed`, radii of the scene a second."""

    speed: float = given(Table.number, 1.5, 0.0, 100.0)
    height: float = given(Table.number, 0.2, 0.0, 100.0)
    seconds: float = given(Table.number, 1.2, 0.02, 60.0)

    def involved(self, world: World) -> tuple[Mapping[str, GaussianModel], Extent]:
        if self.on:
            raise InputError("all objects collide; `on` names a single one")
        if len(world.objects) < 2:
            raise InputError(f"it takes two objects to collide, got {len(world.objects)}")
        return world.objects, measure_extent(world.flat())

    def speeds(self, metric: Mapping[str, GaussianModel]) -> dict[str, Float64]:
        centers = {name: np.asarray(measure_extent(model).center, dtype=np.float64) for name, model in metric.items()}
        middle = np.mean(list(centers.values()), axis=0)
        speeds = {}
        for name, center in centers.items():
            way = middle - center
            way -= (way @ UP) * UP
            speeds[name] = self.speed * way / max(float(np.linalg.norm(way)), 1e-12)
        return speeds

    def planes(self, bottom: float, top: float) -> tuple[matter.Plane, ...]:
        return (matter.Plane((bottom - self.height) * UP, UP),)
