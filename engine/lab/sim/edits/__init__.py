"""Dynamic operations on models: select, edit, track the edits, place many objects in one scene.

Start at `edit` (an edit, its track, and verifying an edited model); `edit_map` finds edits where there is no track.
"""
