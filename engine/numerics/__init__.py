"""Mathematics that knows no format, no renderer and no mark: numba's options, rotations, similarities, spherical
harmonics, wavelets, neighbours, image measures.

All rooms above may import its modules; nothing is exported here. Start at `jit`, which says how kernels are
compiled, and at docs/CONVENTIONS.md, which says what the arrays mean.
"""
