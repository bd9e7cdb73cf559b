"""Photos without poses and scans without a path: what finds those is called, and its result is used.

pycolmap and KISS-ICP are extras; stand-ins of the same interface answer for them here.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.points.cloud import PointCloud
from engine.lab.points.trajectory import Trajectory
from engine.lab.sim.capture import pose_estimation
from engine.lab.sim.capture.scans import Scan
from engine.lab.sim.scenario import capture_steps, read_scenario, sources
from engine.lab.sim.scenario.sources import load_world
from tests.lab.sim.capture.rooms import walk
from tests.lab.sim.capture.scenes import orbit, shell, write_colmap

RANGES = np.random.default_rng(3).uniform(-2.0, 2.0, (500, 3))


class Kiss:
    """KISS-ICP as the door calls it: it knows a path, and hears what it is fed."""

    def __init__(self, path: Trajectory) -> None:
        self.path, self.fed = path, [np.empty((0, 3))]
        self.last_pose: Any = None

    def KissICP(self, config: Any) -> Kiss:
        return self

    def KISSConfig(self) -> Any:
        parts = {name: SimpleNamespace() for name in ("data", "mapping", "registration")}
        return SimpleNamespace(**parts)

    def register_frame(self, points: np.ndarray, times: np.ndarray) -> None:
        pose = np.linalg.inv(self.path.matrices[0]) @ self.path.matrices[len(self.fed) - 1]
        pose[:3, 3] *= pose_estimation.USUAL_RANGE / float(np.linalg.norm(RANGES, axis=1).max())
        self.last_pose = pose
        self.fed.append(points)


def test_odometry_gives_the_path_in_scene_units(monkeypatch: pytest.MonkeyPatch) -> None:
    path = walk(5)
    kiss = Kiss(path)
    assert path.times is not None
    monkeypatch.setattr(pose_estimation, "load_extra", lambda module, extra, purpose: kiss)
    scans = [Scan(PointCloud(RANGES), f"{k}", float(time)) for k, time in enumerate(path.times)]
    found = pose_estimation.odometry(scans)
    home = np.linalg.inv(path.matrices[0])
    np.testing.assert_allclose(found.matrices, home @ path.matrices, atol=1e-9)
    np.testing.assert_array_equal(found.times, path.times)
    assert np.linalg.norm(kiss.fed[1], axis=1).max() == pytest.approx(pose_estimation.USUAL_RANGE)
    back = capture_steps._anchored(found, path)
    np.testing.assert_allclose(back.matrices, path.matrices, atol=1e-9)
    with pytest.raises(InputError, match="at least two"):
        pose_estimation.odometry(scans[:1])


def test_photos_without_poses_are_placed_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photos = write_colmap(tmp_path, shell(), orbit(6))
    calls = []

    def reconstruct(folder: Path, work: str, **settings: Any) -> pose_estimation.Structure:
        calls.append(folder)
        return pose_estimation.Structure(tmp_path, photos=6, photos_placed=5, reprojection_error=0.5)

    monkeypatch.setattr(sources, "reconstruct", reconstruct)
    text = f'[[objects]]\nname = "a"\nphotos = "{photos}"\nsize = 64\nsteps = 3\nbits = 0\nhold_out = 0\n'
    (tmp_path / "s.toml").write_text(text)
    world, notes = load_world(read_scenario(tmp_path / "s.toml").parts, 0, lambda stage, part: None)
    assert calls == [photos]
    assert "placed 5 of 6 photos" in notes[0]
    known = sources.Photos(photos, tmp_path, 64, 3, 0)
    again = sources.load_source(known, "a", "as it is", 0, lambda stage, part: None)
    assert len(calls) == 1  # poses that are known are not looked for
    np.testing.assert_array_equal(again.loaded.model.means, world.objects["a"].means)
