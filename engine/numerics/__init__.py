"""Plain numerics: wavelets, harmonics, similarities, resampling, image metrics, and how numba and BLAS are run.

Everybody above comes in; only `engine.model` and `engine.errors` lie below. Look here before writing a function.
"""
