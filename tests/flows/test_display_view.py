"""A model as people are shown it: all of an object; of a room, what the rig shows."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.flows.views.display_view import choose_view
from engine.model import GaussianModel
from engine.raster import prepare_view, sh_colors
from tests.flows.test_rigs import shell


@pytest.mark.parametrize("size", [(396, 330), (640, 480), (480, 400)])
def test_all_of_an_object_is_shown(plant: GaussianModel, size: tuple[int, int]) -> None:
    camera = choose_view(plant, *size)
    colors = sh_colors(plant.sh, plant.means, camera.position.astype(np.float32))
    alpha = prepare_view(plant, camera).render(colors)[1]
    assert max(side.max() for side in (alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1])) < 0.1
    rows, columns = np.nonzero(alpha > 0.5)
    assert max(np.ptp(rows) / size[1], np.ptp(columns) / size[0]) > 0.6, "and it fills the picture"


def test_a_room_is_seen_as_before() -> None:
    room = shell(4000, 5.0)
    assert choose_view(room, 64, 64).K[0, 0] in {camera.K[0, 0] for camera in make_rig(room, 6, 64, 64)}
