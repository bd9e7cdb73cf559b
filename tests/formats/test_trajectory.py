"""Trajectories: both kinds say the same, every digit survives, and strict means strict."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.errors import FormatError, InputError
from engine.lab.points.trajectory import Trajectory, parse_trajectory, read_trajectory

rng = np.random.default_rng(3)
ROTATIONS = Rotation.random(5, rng=rng)
POSITIONS = rng.standard_normal((5, 3)) * 10
TIMES = np.array([1e9, 1e9 + 0.1, 1e9 + 0.2, 1e9 + 0.35, 1e9 + 1])


def tum() -> str:
    rows = zip(TIMES, POSITIONS, ROTATIONS.as_quat(), strict=True)
    return "# time x y z qx qy qz qw\n" + "".join(
        " ".join(repr(float(v)) for v in (t, *p, *q)) + "\n" for t, p, q in rows
    )


def kitti() -> str:
    matrices = np.concatenate([ROTATIONS.as_matrix(), POSITIONS[:, :, None]], axis=2).reshape(5, 12)
    return "".join(" ".join(repr(float(v)) for v in row) + "\n" for row in matrices)


def matrices() -> np.ndarray:
    result = np.tile(np.eye(4), (5, 1, 1))
    result[:, :3, :3], result[:, :3, 3] = ROTATIONS.as_matrix(), POSITIONS
    return result


@pytest.mark.parametrize("text", [tum, kitti])
def test_both_kinds(text) -> None:
    trajectory = parse_trajectory(text().encode(), file="f")
    np.testing.assert_allclose(trajectory.matrices, matrices(), atol=1e-12)
    if text is tum:
        np.testing.assert_array_equal(trajectory.times, TIMES)
    else:
        assert trajectory.times is None


@pytest.mark.parametrize("text", [tum, kitti])
def test_read_from_a_file(text, tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text(text())
    found = read_trajectory(tmp_path / "poses.txt")
    np.testing.assert_allclose(found.matrices, matrices(), atol=1e-12)


def test_rotations_of_few_digits_become_true_ones() -> None:
    rows = "\n".join(" ".join(f"{float(w):.3f}" for w in line.split()) for line in kitti().splitlines())
    found = parse_trajectory(rows.encode(), file="f").matrices[:, :3, :3]
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(found, ROTATIONS.as_matrix(), atol=2e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no poses"),
        ("# only words\n", "holds no poses"),
        ("1 2 3\n", "row 0: the line holds 3 values"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0\n", "row 1: the line holds 7 values, expected 8"),
        ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "row 1: time 0.0 does not follow 0.0"),
        ("0 0 0 0 0 0 0 2\n", "row 0: the quaternion has length 2"),
        ("0 0 0 0 0 0 0 0\n", "row 0: the quaternion has length 0"),
        ("0 0 nan 0 0 0 0 1\n", "row 0: 'nan' is no finite number"),
        ("0 0 x 0 0 0 0 1\n", "row 0: 'x' is no number"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "row 0: the matrix is no rotation"),
        ("2 0 0 0 0 1 0 0 0 0 1 0\n", "row 0: the matrix is no rotation"),
    ],
)
def test_refused_with_a_reason(text: str, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        parse_trajectory(text.encode(), file="poses.txt")


def test_what_is_no_trajectory(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_trajectory(tmp_path / "none.txt")
    with pytest.raises(InputError, match="no regular file"):
        read_trajectory(tmp_path)
    with pytest.raises(InputError, match="increasing"):
        Trajectory(POSITIONS, np.ones((5, 4)) / 2, TIMES[::-1].copy())
