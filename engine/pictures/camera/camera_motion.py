"""Small motions of a camera: eleven numbers that turn, shift and zoom it and move and skew its picture, and the flow of
pixels they cause.

A motion d = (turn x, y, z in radians; shift x, y, z in units of a scene depth; logarithm of the zoom; x, y of the
principal point in focal lengths; logarithm of the ratio of focal lengths; skew in focal lengths) acts in the camera's
own frame: X' = exp([turn]) X + depth * shift, f' = f exp(zoom), c' = c + f (x, y), fx' = fx exp(ratio). The principal
point is for cropped pictures; from afar it looks like a turn. Ratio and skew are for pictures scaled unevenly, for
photographs of a screen and, all four together, for a model that was stretched: K R A is again a K' R' (RQ).
"""

import numpy as np

from engine.model import Camera, Float64

PARAMETERS, SQUARE, CENTERED = 11, 9, 7
"""Of a motion; of one that leaves the shape of the pixels as it is; and the principal point, too."""


def moved(camera: Camera, motion: Float64, depth: float) -> Camera:
    """A camera after a motion (11,), whose shift is in units of `depth` (scene units)."""
    import cv2

    step = np.eye(4)
    step[:3, :3] = cv2.Rodrigues(np.ascontiguousarray(motion[:3], dtype=np.float64))[0]
    step[:3, 3] = depth * motion[3:6]
    viewmat = step @ camera.viewmat
    # Products of rotations drift away from rotations by rounding.
    u, _, v = np.linalg.svd(viewmat[:3, :3])
    viewmat[:3, :3] = u @ v
    K = camera.K.copy()
    K[:2, 2] += K[:2, :2] @ motion[CENTERED:SQUARE]
    K[0, 1] += K[0, 0] * motion[10]
    K[0, 0] *= np.exp(motion[9])
    K[:2, :2] *= np.exp(motion[6])
    return Camera(viewmat, K, camera.width, camera.height)


def swung(view: Camera, middle: Float64, place: Float64, turn: float, scale: float, shape: tuple[int, ...]) -> Camera:
    """A view's camera turned about its axis by `turn` radians, its lens longer by `scale`, and swung round so that
    what it shows at `middle` appears at `place`, pixels, of a picture of this shape."""
    height, width = shape[:2]
    focal = view.K[0, 0] * scale
    roll = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    was = np.array([*((middle - view.K[:2, 2]) / view.K[0, 0]), 1.0])
    now = np.array([*((place - (width / 2, height / 2)) / focal), 1.0])
    viewmat = np.eye(4)
    viewmat[:3, :3] = _between(roll @ was, now) @ roll
    K = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Camera(viewmat @ view.viewmat, K, width, height)


def carried(camera: Camera, matrix: Float64, width: int, height: int) -> Camera | None:
    """The camera whose picture, of this size in pixels, shows at `matrix` (3, 3) x what this camera's shows at x.

    Turns, zooms and cuts of a picture are a camera's, and so are views of it from aside: None where the matrix turns
    the picture over.
    """
    from scipy.linalg import rq

    seen = matrix @ camera.K
    if not (np.linalg.det(seen) > 0 and np.linalg.det(matrix[:2, :2]) > 0):
        return None
    K, turn = rq(seen)
    signs = np.sign(np.diagonal(K))
    K, turn = K * signs / abs(K[2, 2]), signs[:, None] * turn
    viewmat = np.eye(4)
    viewmat[:3, :3] = turn
    return Camera(viewmat @ camera.viewmat, K, width, height)


def farther(camera: Camera, depth: float, factor: float) -> Camera:
    """A camera so many times as far from what it sees at a depth (scene units), behind a lens as much longer."""
    motion = np.eye(4)
    motion[2, 3] = depth * (factor - 1.0)
    K = camera.K * np.array([[factor, 1.0, 1.0], [1.0, factor, 1.0], [1.0, 1.0, 1.0]])
    return Camera(motion @ camera.viewmat, K, camera.width, camera.height)


def normalized(points: Float64, camera: Camera) -> tuple[Float64, Float64]:
    """Image coordinates (P, 2) for focal length 1, and depths (P,), of world points (P, 3)."""
    local = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    depth = local[:, 2]
    return local[:, :2] / np.where(np.abs(depth) > 1e-12, depth, 1e-12)[:, None], depth


def project(points: Float64, camera: Camera) -> Float64:
    """Pixels (P, 2) of world points (P, 3); far outside every picture (-1e9) where they lie behind the camera."""
    rays, depth = normalized(points, camera)
    pixels = rays @ camera.K[:2, :2].T + camera.K[:2, 2]
    return np.where(depth[:, None] > 1e-9, pixels, -1e9)


def point_columns(rays: Float64, depth: Float64, K: Float64) -> Float64:
    """(P, 2, 11) flow of points by each parameter of a motion, pixels of intrinsics K, at rays (P, 2) for focal length
    1 and depths (P,) in units of the shift."""
    a, b = rays.T
    near = 1.0 / depth
    zero, one = np.zeros_like(a), np.ones_like(a)
    horizontal = [-a * b, 1.0 + a * a, -b, near, zero, -a * near, a, one, zero, a, b]
    vertical = [-1.0 - b * b, a * b, a, zero, near, -b * near, b, zero, one, zero, zero]
    return np.asarray(K[:2, :2] @ np.stack([np.stack(horizontal, axis=1), np.stack(vertical, axis=1)], axis=1))


def _between(a: Float64, b: Float64) -> Float64:
    """(3, 3) the shortest rotation from one direction to another, less than half a turn apart."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    v = np.cross(a, b)
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + a @ b))
