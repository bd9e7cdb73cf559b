"""Dynamic operations on models: select, edit, track the edits, place many objects in one scene."""

from engine.sim.edits.edit import Edit, Edited, Recoloring
from engine.sim.edits.masks import lift_masks, mask_shares, project_selection
from engine.sim.edits.operations import (
    delete,
    duplicate,
    move,
    place,
    recolor,
    recolor_towards,
    rotate,
    scale,
)
from engine.sim.edits.selection import segment, segment_at, select_box, select_sphere
from engine.sim.edits.tracking import EditTrack, edited_record, verify_edited

__all__ = [
    "Edit",
    "EditTrack",
    "Edited",
    "Recoloring",
    "delete",
    "duplicate",
    "edited_record",
    "lift_masks",
    "mask_shares",
    "move",
    "place",
    "project_selection",
    "recolor",
    "recolor_towards",
    "rotate",
    "scale",
    "segment",
    "segment_at",
    "select_box",
    "select_sphere",
    "verify_edited",
]
