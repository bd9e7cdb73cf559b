"""Three pictures of the thief's listing and one of the unmarked original: that one is named, and does not count."""

from __future__ import annotations

import numpy as np

from engine.flows.verify.search import verify_images
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.raster import render

SIDE = 256


def test_a_picture_of_the_original_is_named_and_left_out(scene: MarkedScene) -> None:
    cameras = make_rig(scene.original, 4, SIDE, SIDE, jitter=np.random.default_rng(0).random((4, 4)))
    models = (scene.marked, scene.original, scene.marked, scene.marked)
    shots = [to_8_bit(render(model, camera)) for model, camera in zip(models, cameras, strict=True)]
    mixed = verify_images(shots, scene.opened, cameras=cameras)
    own = [0, 2, 3]
    alone = verify_images([shots[n] for n in own], scene.opened, cameras=[cameras[n] for n in own])
    assert [note for note in mixed.claim.notes if note.startswith("left out: picture 2 ")]
    assert not [note for note in alone.claim.notes if note.startswith("left out")]
    assert mixed.claim.z == alone.claim.z
    assert mixed.claim.tries == alone.claim.tries
    assert all(camera is not None for camera in mixed.cameras)
