"""Scenes in every form that people have: plain Gaussians, clips that move, models in codebooks.

`scene_files` reads and writes them, `scene_marking` marks them, `clip_marking` tells a moment of a clip.
"""
