"""Three-vectors and 3 x 3 matrices (nine entries, row by row) of lanes or of float32 scalars."""

# mypy: allow-untyped-defs, allow-untyped-calls
from engine.kernels.jit import inlined

__all__ = ["add", "cross", "dot", "row_times", "scale_columns", "times"]


@inlined
def dot(u, v):
    """u . v"""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inlined
def cross(u, v):
    """u x v"""
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


@inlined
def add(u, v):
    """u + v"""
    return (u[0] + v[0], u[1] + v[1], u[2] + v[2])


@inlined
def times(m, v):
    """M v"""
    return (dot(m[0:3], v), dot(m[3:6], v), dot(m[6:9], v))


@inlined
def row_times(v, m):
    """v^T M"""
    return (
        v[0] * m[0] + v[1] * m[3] + v[2] * m[6],
        v[0] * m[1] + v[1] * m[4] + v[2] * m[7],
        v[0] * m[2] + v[1] * m[5] + v[2] * m[8],
    )


@inlined
def scale_columns(m, s):
    """M diag(s)"""
    return (
        m[0] * s[0],
        m[1] * s[1],
        m[2] * s[2],
        m[3] * s[0],
        m[4] * s[1],
        m[5] * s[2],
        m[6] * s[0],
        m[7] * s[1],
        m[8] * s[2],
    )
