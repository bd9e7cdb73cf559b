"""Variants of 3D Gaussian Splatting, each loaded, marked, rendered, attacked and claimed (the paper's Table 4).

How discs, codebooks, generated models and clips are made and measured; those that people have are read and marked by
`engine.scenes`. Start at `discs` (the shortest); a marking special to a variant is a
`flows.embed.variant.Variant`.
"""
