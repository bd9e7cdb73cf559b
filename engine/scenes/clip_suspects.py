"""Suspects that may be a moment of a clip: the owner's unmarked clip tells how the scene looked then."""

import os

import numpy as np

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.search import Suspect, Verification
from engine.scenes.clip_marking import verify_moment, verify_moving_images
from engine.scenes.frame_folders import FrameSequence
from engine.scenes.scene_files import read_scene
from engine.scenes.spacetime import SpacetimeModel

__all__ = ["MOMENTS", "verify_in_motion"]

MOMENTS = 9
"""Moments that pictures are compared with; each is a try."""


def verify_in_motion(
    suspect: Suspect, opened: OpenedRecord, original: str | os.PathLike[str], config: VerifyConfig
) -> Verification:
    """Does this model, exported from a clip, or do these pictures of one moment of it, carry the mark?

    `original` is the file or the folder of the unmarked clip that the record commits to; InputError if it is another,
    or none. All moments that pictures are compared with are counted as tries; which moment a model shows is told by
    geometry alone.
    """
    loaded = read_scene(original)
    if not isinstance(loaded.scene, SpacetimeModel | FrameSequence):
        raise InputError(f"{original}: is no clip that moves ({loaded.format})")
    if suspect.model is not None:
        return verify_moment(suspect.model, opened, loaded.scene, config=config)
    times = np.linspace(*loaded.scene.span, MOMENTS).tolist()
    return verify_moving_images(suspect.pictures, opened, loaded.scene, times, config, suspect.cameras)[0]
