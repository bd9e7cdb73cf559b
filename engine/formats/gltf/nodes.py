"""Where the nodes of a glTF scene put its meshes: one similarity for each time a mesh is shown.

Khronos Group, "glTF 2.0 Specification", section 3.5. What stretches Gaussians unevenly is refused: their spherical
harmonics would have no place to go.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from engine.errors import UnsupportedFormatError
from engine.formats.declaration import Read
from engine.formats.gltf.container import Asset
from engine.formats.repairs import VISIBLE_ROUNDING, Repair
from engine.model import Float64, GaussianModel, joined
from engine.numerics.similarity import quaternion_to_rotation, transform_model

MAX_NODES = 1 << 14
VISIBILITY = "KHR_node_visibility"
_UNEVEN = 1e-4
"""Relative difference of the axes' scales, or of a rotation's columns from right angles, that float32 may leave."""


def shown_meshes(asset: Asset) -> Iterator[tuple[int, Float64]]:
    """Index of every mesh that the scene shows, and the global matrix (4, 4) of the node that shows it; all meshes at
    the origin where the asset has no nodes.

    FormatError if a node is shown twice (nodes are trees), or an index or a number is none.
    """
    nodes = asset.rows("nodes")
    if not nodes:
        yield from ((mesh, np.eye(4)) for mesh in range(len(asset.rows("meshes"))))
        return
    if len(nodes) > MAX_NODES:
        raise asset.fault(f"there are {len(nodes)} nodes, at most {MAX_NODES} are read", "nodes")
    waiting: list[tuple[Any, Float64]] = [(root, np.eye(4)) for root in _roots(asset, nodes)]
    seen: set[int] = set()
    while waiting:
        index, above = waiting.pop()
        node = asset.row("nodes", index)
        if index in seen:
            raise asset.fault(f"node {index} is there twice: nodes must be trees", "nodes")
        seen.add(index)
        if _is_hidden(node):
            continue
        matrix = above @ _matrix(asset, node, index)
        waiting += [(child, matrix) for child in reversed(_list(asset, node, "children", index))]
        if "mesh" in node:
            yield node["mesh"], matrix


def _is_hidden(node: Mapping[str, Any]) -> bool:
    """By KHR_node_visibility, which holds for all below the node, too."""
    for key in ("extensions", VISIBILITY):
        node = node.get(key, {}) if isinstance(node, dict) else {}
    return isinstance(node, dict) and node.get("visible") is False


def primitives_of(asset: Asset, mesh: object) -> list[Mapping[str, Any]]:
    """All primitives of a mesh; FormatError where they are no objects."""
    found = asset.row("meshes", mesh).get("primitives")
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise asset.fault("has no list of primitives", f"mesh {mesh}")
    return found


def placed(parts: Iterable[tuple[GaussianModel, Iterable[Repair], Float64]], *, file: str) -> Read:
    """Parts of a scene, with what was mended, where their matrices (4, 4), in PLY's axes, put them; around the first
    one's place, as the origin, where float32 would round centers as far out."""
    models: list[GaussianModel] = []
    repairs: list[Repair] = []
    origin = np.zeros(3)
    for model, mended, matrix in parts:
        repairs += mended
        scale, rotation, shift = _as_similarity(matrix, file=file)
        step = float(np.spacing(np.float32(np.abs(shift).max()))) / 2  # that of float32
        if not models and step > VISIBLE_ROUNDING * float(np.median(scale * model.scales)):
            origin = np.rint(shift)
        if origin.any() or (matrix != np.eye(4)).any():
            model = transform_model(model, scale, rotation, shift - origin)
        models.append(model)
    if origin.any():
        x, y, z = origin.tolist()
        text = f"centers far out, which float32 would round: read relative to ({x:.0f}, {y:.0f}, {z:.0f})"
        repairs.append(Repair("origin_moved", sum(map(len, models)), text))
        return joined(models).with_(origin=(x, y, z)), tuple(repairs)
    return joined(models), tuple(repairs)


def _as_similarity(matrix: Float64, *, file: str) -> tuple[float, Float64, Float64]:
    """Scale, rotation (3, 3) and shift (3,) of a matrix; UnsupportedFormatError if it stretches, shears or mirrors."""
    linear = matrix[:3, :3]
    scale = float(np.cbrt(max(np.linalg.det(linear), 0.0)))
    rotation = linear / scale if scale > 0 else linear
    if not (0 < scale < np.inf) or np.abs(rotation.T @ rotation - np.eye(3)).max() > _UNEVEN:
        lengths = np.linalg.norm(linear, axis=0)
        message = f"its node stretches, shears or mirrors the Gaussians (axes {', '.join(f'{v:.4g}' for v in lengths)})"
        raise UnsupportedFormatError(message, file=file, element="nodes")
    u, _, v = np.linalg.svd(rotation)  # the nearest rotation: float32 in the file leaves it a little off
    return scale, u @ v, matrix[:3, 3].copy()


def _roots(asset: Asset, nodes: list[Any]) -> list[Any]:
    scenes = asset.rows("scenes")
    if scenes:
        scene = asset.json.get("scene", 0)
        return list(reversed(_list(asset, asset.row("scenes", scene), "nodes", scene)))
    below: set[Any] = set()
    for index in range(len(nodes)):
        below.update(child for child in _list(asset, asset.row("nodes", index), "children", index))
    return [index for index in reversed(range(len(nodes))) if index not in below]


def _list(asset: Asset, row: Mapping[str, Any], key: str, index: object) -> list[int]:
    found = row.get(key, [])
    if not isinstance(found, list) or not all(type(each) is int for each in found):
        raise asset.fault(f"node or scene {index!r:.20} has no list of indices", "nodes", key)
    return found


def _matrix(asset: Asset, node: Mapping[str, Any], index: int) -> Float64:
    if "matrix" in node:
        return _numbers(asset, node, "matrix", 16, index).reshape(4, 4).T  # column-major
    matrix = np.eye(4)
    quat = _numbers(asset, node, "rotation", 4, index, (0.0, 0.0, 0.0, 1.0))[[3, 0, 1, 2]]
    length = float(np.linalg.norm(quat))
    if not length > 0:
        raise asset.fault(f"node {index} has a rotation of zeros", "nodes", "rotation")
    scale = _numbers(asset, node, "scale", 3, index, (1.0, 1.0, 1.0))
    matrix[:3, :3] = quaternion_to_rotation(quat / length) * scale
    matrix[:3, 3] = _numbers(asset, node, "translation", 3, index, (0.0, 0.0, 0.0))
    return matrix


def _numbers(
    asset: Asset, node: Mapping[str, Any], key: str, count: int, index: int, default: tuple[float, ...] = ()
) -> Float64:
    values = node.get(key, list(default))
    sound = isinstance(values, list) and len(values) == count
    if not sound or not all(type(v) in (int, float) and abs(v) < 1e30 for v in values):
        raise asset.fault(f"node {index} needs {count} finite numbers", "nodes", key)
    return np.array(values, dtype=np.float64)
