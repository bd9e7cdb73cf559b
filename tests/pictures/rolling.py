"""A camera that lies on its side."""

import numpy as np

from engine.model import Camera


def rolled(camera: Camera, angle: float) -> Camera:
    """The camera turned about its axis, radians."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return Camera(turn @ camera.viewmat, camera.K, camera.width, camera.height)
