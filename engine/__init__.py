"""Mark3DGS: ownership watermarks for 3D Gaussian Splatting models."""

import os as _os

# One thread for BLAS, whatever was asked for: sums split otherwise differ in their last digits, and a claim must be
# the same on every machine. It costs nothing (an embedding is faster without a second pool beside numba's). OpenBLAS
# reads it when numpy is loaded: a program that imports numpy first keeps its own choice.
_os.environ["OPENBLAS_NUM_THREADS"] = "1"
