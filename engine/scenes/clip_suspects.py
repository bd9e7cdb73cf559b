"""Suspects that may be a moment of a clip: the owner's unmarked clip tells how the scene looked then."""

import os
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.search import Suspect, Verification
from engine.formats.guards import opening
from engine.formats.ply.header import MAX_HEADER_BYTES
from engine.scenes.clip_marking import verify_moment, verify_moving_images
from engine.scenes.frame_folders import FrameSequence
from engine.scenes.scene_files import FRAMES, folder_kind, read_scene
from engine.scenes.spacetime import SpacetimeModel
from engine.scenes.spacetime_ply import is_spacetime

__all__ = ["MOMENTS", "is_clip", "verify_in_motion"]

MOMENTS = 9
"""Moments that pictures are compared with; each is a try."""


def is_clip(path: str | os.PathLike[str]) -> bool:
    """Whether a file or a folder holds a clip; of a file's bytes only the header is looked at."""
    with opening(Path(path), str(path)):
        if folder_kind(path) == FRAMES:
            return True
        if not Path(path).is_file():
            return False
        with open(path, "rb") as stream:
            return is_spacetime(stream.read(MAX_HEADER_BYTES))


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
