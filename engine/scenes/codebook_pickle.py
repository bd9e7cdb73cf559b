"""kmeans_args.npy of Compact3D: a pickled dict, read by an unpickler that builds only plain values."""

import io
import pickle
from typing import Any

import numpy as np

from engine.errors import FormatError, UnsupportedFormatError
from engine.scenes.codebook_model import GROUPS

__all__ = ["read_args"]

MAX_INDEX_BITS = 31
"""An index is an int32."""

_VALUES = (ValueError, TypeError, LookupError, AttributeError, OverflowError)
_BROKEN = (*_VALUES, EOFError, MemoryError, RecursionError, pickle.UnpicklingError)
"""Whatever a broken pickle does to its reader."""


class _Bare:
    """Stands for numpy's array and dtype while a pickle is read: takes its state, does nothing."""

    state: Any = None

    def __init__(self, *_: object) -> None:
        pass

    def __setstate__(self, state: object) -> None:
        self.state = state


class _Unpickler(pickle.Unpickler):
    """Builds plain values; numpy's array is an empty stand-in, everything else is refused."""

    def find_class(self, module: str, name: str) -> Any:
        known = {"numpy": ("ndarray", "dtype"), "numpy.core.multiarray": ("_reconstruct",)}
        if name in known.get(module.replace("numpy._core", "numpy.core"), ()):
            return _Bare
        raise pickle.UnpicklingError(f"names {module[:40]}.{name[:40]}, which is not loaded here")


def read_args(data: bytes, *, file: str) -> tuple[list[str], int, int]:
    """Groups in the order of the indices, bits of an index, and of all of them, from kmeans_args.npy; nothing in it is
    run.

    The groups are distinct and all of `GROUPS`, an index has 1 to 31 bits, and the total is as the file announces it.
    FormatError where the bytes are no pickled dict of these values; UnsupportedFormatError where a group is named that
    is not read here.
    """
    stream = io.BytesIO(data)
    try:
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ValueError("is no version 1.0 .npy file")
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        if shape != () or dtype != np.dtype(object):
            raise ValueError(f"holds an array {shape} of {dtype}, expected one pickled dict")
        array = _Unpickler(stream).load()
        args = array.state[-1][0]
        params, index_bits, total = args["params"], args["n_bits"], args["total_len"]
    except _BROKEN as error:
        raise FormatError(f"cannot be read: {str(error)[:120]!a}", file=file) from None
    if not isinstance(params, list) or not all(isinstance(name, str) for name in params) or not params:
        raise FormatError("names no list of groups", file=file, prop="params")
    for name in params:
        if name not in GROUPS:
            known = ", ".join(GROUPS)
            raise UnsupportedFormatError(f"quantises {name[:40]!a}; only {known} are read here", file=file)
    if len(set(params)) != len(params):
        raise FormatError("names a group twice", file=file, prop="params")
    if type(index_bits) is not int or not 1 <= index_bits <= MAX_INDEX_BITS:
        raise FormatError(f"{str(index_bits)[:40]!a} bits cannot be an index", file=file, prop="n_bits")
    if type(total) is not int:
        raise FormatError(f"{str(total)[:40]!a} is no number of bits", file=file, prop="total_len")
    return params, index_bits, total
