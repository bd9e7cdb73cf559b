"""Variants of 3D Gaussian Splatting, each loaded, marked, rendered, attacked and claimed (the paper's Table 4).

Discs, codebooks, generated models, scenes that move: one module each. Studies and scenarios come in. Start at `discs`
(the shortest) or `moving` (why a claim at a moment stays a theorem); a marking special to a variant is a
`pipeline.variant.Variant`.
"""
