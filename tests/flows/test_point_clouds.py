"""A marked model that somebody made a colored point cloud of is still a suspect, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.errors import UnsupportedFormatError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.verify.search import verify_model
from engine.formats import read_model
from engine.model import SH_C0, GaussianModel
from engine.numerics.similarity import mirror_model, quaternion_to_rotation, transform_model
from engine.scenes.scene_files import read_scene, read_suspect
from engine.watermark.keys import OwnerKey
from tests.scenes import sparse_plant

KEY = OwnerKey(bytes(range(32)))


@pytest.fixture(scope="module")
def marked() -> tuple[GaussianModel, OpenedRecord]:
    model = read_model(sparse_plant("ply")).model
    made = embed(model, KEY, original_sha256="0" * 64, config=profile("fast", landmark_views=0))
    return made.model, open_record(made.record.to_bytes(KEY), KEY)


def cloud_of(model: GaussianModel, faces: int = 0) -> bytes:
    """What programs export: places, and colors in bytes; with faces a mesh."""
    rgb = np.clip(np.rint((0.5 + SH_C0 * model.sh[:, 0]) * 255), 0, 255).astype(np.uint8)
    rows = np.zeros(len(model), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    rows["xyz"], rows["rgb"] = model.means, rgb
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(model)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    corners = b""
    if faces:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
        corners = np.array([(3, (0, 1, 2))] * faces, [("n", "u1"), ("at", "<i4", 3)]).tobytes()
    return "\n".join([*lines, "end_header", ""]).encode() + rows.tobytes() + corners


@pytest.mark.parametrize("faces", [0, 7])
def test_the_mark_is_read_where_points_are_the_centers(
    tmp_path: Path, marked: tuple[GaussianModel, OpenedRecord], faces: int
) -> None:
    model, opened = marked
    (tmp_path / "cloud.ply").write_bytes(cloud_of(model, faces))
    loaded = read_suspect(tmp_path / "cloud.ply")
    assert (loaded.format, [each.code for each in loaded.repairs]) == ("points", ["points"])
    found = verify_model(loaded.model, opened)
    assert found.claim.verdict == "marked"
    with pytest.raises(UnsupportedFormatError, match="is a colored point cloud"):
        read_scene(tmp_path / "cloud.ply")


def test_a_cloud_that_was_moved_and_halved_is_found(tmp_path: Path, marked: tuple[GaussianModel, OpenedRecord]) -> None:
    model, opened = marked
    rng = np.random.default_rng(3)
    half = model.take(np.flatnonzero(rng.random(len(model)) < 0.5))
    for moved in (half, mirror_model(half)):
        moved = transform_model(moved, 2.5, quaternion_to_rotation([0.2, -0.4, 0.8, 0.4]), np.array([3.0, -8.0, 0.5]))
        (tmp_path / "cloud.ply").write_bytes(cloud_of(moved))
        found = verify_model(read_suspect(tmp_path / "cloud.ply").model, opened)
        assert found.claim.verdict == "marked"


def test_a_moved_cloud_of_the_unmarked_model_is_derived_and_carries_nothing(
    tmp_path: Path, marked: tuple[GaussianModel, OpenedRecord]
) -> None:
    half = read_model(sparse_plant("ply")).model
    half = half.take(np.arange(0, len(half), 2))
    moved = transform_model(half, 0.3, quaternion_to_rotation([0.6, 0.0, 0.8, 0.0]), np.array([1.0, 1.0, 1.0]))
    (tmp_path / "cloud.ply").write_bytes(cloud_of(moved))
    found = verify_model(read_suspect(tmp_path / "cloud.ply").model, marked[1])
    assert found.claim.verdict != "marked"
    assert found.claim.derivation.derived


def test_points_of_the_unmarked_model_carry_nothing(tmp_path: Path, marked: tuple[GaussianModel, OpenedRecord]) -> None:
    (tmp_path / "cloud.ply").write_bytes(cloud_of(read_model(sparse_plant("ply")).model))
    found = verify_model(read_suspect(tmp_path / "cloud.ply").model, marked[1])
    assert found.claim.verdict != "marked"


def test_the_mark_is_read_in_the_corners_of_an_obj(tmp_path: Path, marked: tuple[GaussianModel, OpenedRecord]) -> None:
    model, opened = marked
    rgb = np.clip(0.5 + SH_C0 * model.sh[:, 0], 0, 1)
    corners = ["v " + " ".join(f"{x:.6f}" for x in row) for row in np.hstack([model.means, rgb]).tolist()]
    (tmp_path / "mesh.obj").write_text("\n".join(["mtllib none.mtl", *corners, "f 1 2 3", ""]))
    loaded = read_suspect(tmp_path / "mesh.obj")
    assert (loaded.format, len(loaded.model)) == ("points", len(model))
    assert verify_model(loaded.model, opened).claim.verdict == "marked"


@pytest.mark.parametrize("line", ["v 1 2 3", "v 1 2 3 x y z", "v 1 2 3 0.5 0.5"])
def test_an_obj_without_colors_stays_refused(tmp_path: Path, line: str) -> None:
    (tmp_path / "bare.obj").write_text(f"mtllib a.mtl\n{line}\n{line}\n")
    with pytest.raises(UnsupportedFormatError, match="is a mesh"):
        read_suspect(tmp_path / "bare.obj")


def test_the_reconstruction_of_the_mesh_measurement_finds_a_ball() -> None:
    from tests.flows.measure_meshes import poisson_mesh

    normals = np.random.default_rng(0).normal(size=(20_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    corners = poisson_mesh(2.0 * normals + [5.0, 0.0, 1.0], normals, 48)
    np.testing.assert_allclose(np.linalg.norm(corners - [5.0, 0.0, 1.0], axis=1), 2.0, atol=1.2 * 4 / 48)
    assert len(corners) > 4_000
