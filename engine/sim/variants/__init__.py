"""Variants of 3D Gaussian Splatting, each loaded, marked, rendered, attacked and claimed (paper, Table 4)."""
