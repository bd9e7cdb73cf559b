"""Cameras from other programs' files: INRIA's and NeRF's JSON, COLMAP models, trajectories. Start at `files`."""
