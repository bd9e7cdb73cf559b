"""Variants of 3D Gaussian Splatting, each loaded, marked, rendered, attacked and claimed (the paper's Table 4).

How discs, codebooks, generated models and clips are made and measured; `engine.scenes` reads and marks files of these
kinds. Start at `synthetic`; a marking special to a variant is a
`flows.embed.variant.Variant`.
"""
