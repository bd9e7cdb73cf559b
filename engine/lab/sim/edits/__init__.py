"""Dynamic operations on models: select, edit, track the edits, place many objects in one scene.

Scenarios and studies come in by the names gathered here. Start at `operations` (an edit) and `tracking` (what verifying
an edited model needs); `edit_map` tells edits from the mark where nobody kept a track.
"""

from engine.lab.sim.edits.bvh import BoxTree
from engine.lab.sim.edits.edit import Attribute, Edit, Edited, Recoloring
from engine.lab.sim.edits.edit_map import Change, EditMap, map_edits
from engine.lab.sim.edits.edit_regions import EditedRegion
from engine.lab.sim.edits.inpainting import InpaintConfig, inpaint
from engine.lab.sim.edits.objects import FlatScene, PlacedObject, Scene, model_box
from engine.lab.sim.edits.operations import delete, duplicate, move, place, recolor, recolor_towards, rotate, scale
from engine.lab.sim.edits.pieces import ObjectFinding, Pieces, register_pieces, verify_objects, verify_pieces
from engine.lab.sim.edits.selection import (
    lift_masks,
    mask_shares,
    project_selection,
    segment,
    segment_at,
    select_box,
    select_sphere,
)
from engine.lab.sim.edits.tracking import EditTrack, edited_record, verify_edited

__all__ = [
    "Attribute",
    "BoxTree",
    "Change",
    "Edit",
    "EditMap",
    "EditTrack",
    "Edited",
    "EditedRegion",
    "FlatScene",
    "InpaintConfig",
    "ObjectFinding",
    "Pieces",
    "PlacedObject",
    "Recoloring",
    "Scene",
    "delete",
    "duplicate",
    "edited_record",
    "inpaint",
    "lift_masks",
    "map_edits",
    "mask_shares",
    "model_box",
    "move",
    "place",
    "project_selection",
    "recolor",
    "recolor_towards",
    "register_pieces",
    "rotate",
    "scale",
    "segment",
    "segment_at",
    "select_box",
    "select_sphere",
    "verify_edited",
    "verify_objects",
    "verify_pieces",
]
