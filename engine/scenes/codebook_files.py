"""The files of Compact3D / CompGS: a PLY with what is not quantised, and three files of codebooks in its folder.

====================  ==================================================================================
kmeans_centers.pth    torch archive: group -> (M, d) float tensor
kmeans_inds.bin       indices of all groups, one group after the other, `n_bits` each, highest bit first
kmeans_args.npy       pickled dict: params (names of the groups, in order), n_bits, total_len (bits)
====================  ==================================================================================

Both the archive and the pickle can run code when loaded as the public code does. Here the archive is opened with
`weights_only` once its zip is known to be stored plainly, and the pickle by an unpickler that builds nothing but
lists, dicts, texts and numbers.
"""

import io
import os
import pickle
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.extras import load_extra
from engine.formats.file_writing import write_whole
from engine.formats.guards import opening
from engine.formats.ply.body import read_tables
from engine.formats.ply.header import parse_header
from engine.formats.repairs import MAGNITUDE_LIMIT
from engine.model import Float32, Int32
from engine.scenes.codebook_model import GROUPS, CodebookModel

__all__ = ["read_codebook", "write_codebook"]

PLY, CENTERS, INDICES, ARGS = "point_cloud.ply", "kmeans_centers.pth", "kmeans_inds.bin", "kmeans_args.npy"

MAX_CENTERS_BYTES = 1 << 28
"""Codebooks of 32,768 entries for all groups hold 7.5 MB; 256 MB is more than anyone wrote."""
MAX_ARGS_BYTES = 1 << 16

_PROPERTIES = {
    "xyz": ("x", "y", "z"),
    "dc": ("f_dc_0", "f_dc_1", "f_dc_2"),
    "opacity": ("opacity",),
    "scale": ("scale_0", "scale_1", "scale_2"),
    "rot": ("rot_0", "rot_1", "rot_2", "rot_3"),
}


def read_codebook(folder: str | os.PathLike[str]) -> CodebookModel:
    """Read the folder of a compressed model: its four files.

    FormatError where a file's bytes are not what they should be, an index points outside its codebook, or a value is no
    number; UnsupportedFormatError where a group is quantised that is not read here; InputError where a file is missing
    or cannot be read.
    """
    base = Path(folder)
    params, index_bits, total = _read_args(_content(base / ARGS, MAX_ARGS_BYTES), file=str(base / ARGS))
    centers = _read_centers(_content(base / CENTERS, MAX_CENTERS_BYTES), params, str(base / CENTERS))
    plain = _read_plain(_content(base / PLY), params, str(base / PLY))
    count = len(plain["opacity"])
    file, needed = str(base / INDICES), len(params) * count * index_bits
    if total != needed:
        message = f"announces {total} bits, but {len(params)} groups of {count} Gaussians take {needed}"
        raise FormatError(message, file=str(base / ARGS), prop="total_len")
    packed = _content(base / INDICES)
    if len(packed) != (total + 7) // 8:
        raise FormatError(f"holds {len(packed)} bytes, expected {(total + 7) // 8}", file=file)
    indices = {}
    for number, name in enumerate(params):
        indices[name] = _unpack(packed, number * count, count, index_bits)
        codes = len(centers[name])
        outside = indices[name] >= codes
        if outside.any():
            row = int(np.argmax(outside))
            message = f"index {indices[name][row]} points outside its {codes} codes"
            raise FormatError(message, file=file, element=name, row=row)
    try:
        return CodebookModel(plain, centers, indices, index_bits)
    except InputError as error:
        raise FormatError(str(error), file=str(base)) from None


def write_codebook(model: CodebookModel, folder: str | os.PathLike[str]) -> int:
    """Write the four files of a compressed model, each whole or not at all; the folder is made. Returns their bytes.

    The same model gives the same bytes.
    """
    torch = load_extra("torch", "train", "a folder of codebooks")  # for the archive of centres alone

    base = Path(folder)
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    params = list(model.centers)
    archive = io.BytesIO()
    torch.save({name: torch.from_numpy(model.centers[name].copy()) for name in params}, archive)
    bits = np.concatenate([_bits(model.indices[name], model.index_bits) for name in params])
    args = {"params": params, "n_bits": model.index_bits, "total_len": len(bits)}
    pickled = io.BytesIO()
    np.save(pickled, np.array(args, dtype=object), allow_pickle=True)
    files: dict[str, Iterable[bytes]] = {
        PLY: _write_plain(model),
        CENTERS: [archive.getvalue()],
        INDICES: [np.packbits(bits.astype(np.uint8)).tobytes()],
        ARGS: [pickled.getvalue()],
    }
    return sum(write_whole(base / name, pieces) for name, pieces in files.items())


def _content(path: Path, limit: int | None = None) -> bytes:
    with opening(path, str(path)):
        if not path.is_file():
            raise InputError(f"{path}: there is no such file")
        size = path.stat().st_size
        if limit is not None and size > limit:
            raise FormatError(f"is {size} bytes long, more than {limit}", file=str(path))
        return path.read_bytes()


def _read_centers(data: bytes, params: list[str], file: str) -> dict[str, Float32]:
    torch = load_extra("torch", "train", "a folder of codebooks")

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:  # torch stores; a deflated entry may be a bomb
            packed = any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist())
        if packed:
            raise FormatError("is a compressed archive, which torch does not write", file=file)
        loaded = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except FormatError:
        raise
    except Exception as error:  # torch raises almost anything on a broken archive
        reason = ascii(str(error).splitlines()[0][:120]) if str(error) else type(error).__name__
        raise FormatError(f"cannot be read as an archive of tensors: {reason}", file=file) from None
    if not isinstance(loaded, dict):
        raise FormatError(f"holds a {type(loaded).__name__}, expected a dict of tensors", file=file)
    centers = {}
    for name in params:
        tensor = loaded.get(name)
        if not isinstance(tensor, torch.Tensor) or tensor.layout != torch.strided or tensor.ndim != 2:
            raise FormatError("has no table of centres", file=file, element=name)
        if tensor.shape[0] < 1 or tensor.numel() * 4 > MAX_CENTERS_BYTES:  # strides can claim any shape
            raise FormatError(f"centres of shape {tuple(tensor.shape)}", file=file, element=name)
        values: Float32 = tensor.detach().to(torch.float32).contiguous().numpy().copy()
        if name == "sh" and values.shape[1] not in (9, 24, 45):
            raise FormatError(f"{values.shape[1]} values an entry, expected 9, 24 or 45", file=file, element=name)
        bad = ~(np.abs(values) <= MAGNITUDE_LIMIT).all(axis=1)
        if bad.any():
            raise FormatError("a value is no number", file=file, element=name, row=int(np.argmax(bad)))
        centers[name] = values
    return centers


def _read_plain(data: bytes, params: list[str], file: str) -> dict[str, Float32]:
    header = parse_header(data, file=file)
    vertex = header.element("vertex")
    if vertex is None:
        raise FormatError("has no element 'vertex'", file=file)
    rest = sum(name.startswith("f_rest_") for name in vertex.names)
    wanted = {group: names for group, names in _PROPERTIES.items() if group not in params}
    if "sh" not in params and rest:
        if rest not in (9, 24, 45):
            raise FormatError(f"{rest} properties f_rest_*, expected 9, 24 or 45", file=file, element="vertex")
        channel = rest // 3  # the file is channel-major
        wanted["sh"] = tuple(f"f_rest_{c * channel + k}" for k in range(channel) for c in range(3))
    for names in wanted.values():
        for name in names:
            if name not in vertex.names:
                raise FormatError("is missing", file=file, element="vertex", prop=name)
    records = read_tables(data, header, ["vertex"], file=file)["vertex"]
    if not len(records):
        raise FormatError("holds no Gaussians", file=file, element="vertex")
    plain = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for group, names in wanted.items():
            plain[group] = np.stack([records[name].astype(np.float32) for name in names], axis=1)
            # An infinite opacity is an opacity of one; everything else must be a number.
            bad = np.isnan(plain[group]) if group == "opacity" else ~(np.abs(plain[group]) <= MAGNITUDE_LIMIT)
            if bad.any():  # rows cannot be dropped: the indices count them
                row, column = (int(i) for i in np.argwhere(bad)[0])
                raise FormatError("is no number", file=file, element="vertex", row=row, prop=names[column])
    return plain


def _write_plain(model: CodebookModel) -> Iterable[bytes]:
    columns: list[tuple[str, npt.NDArray[Any]]] = []
    for group in ("xyz", "dc", "sh", "opacity", "scale", "rot"):
        values = model.plain.get(group)
        if values is None:
            continue
        if group == "sh":
            coefficients = values.shape[1] // 3
            major = values.reshape(len(model), coefficients, 3).transpose(0, 2, 1).reshape(len(model), -1)
            columns += [(f"f_rest_{i}", major[:, i]) for i in range(major.shape[1])]
        else:
            columns += [(name, values[:, i]) for i, name in enumerate(_PROPERTIES[group])]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(model)}"]
    lines += [f"property float {name}" for name, _ in columns]
    yield ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")
    yield np.stack([column for _, column in columns], axis=1).astype("<f4").tobytes()


def _bits(indices: Int32, width: int) -> npt.NDArray[np.uint8]:
    """(N * width,) bits of each index, highest first."""
    shifts = np.arange(width - 1, -1, -1)
    return ((indices[:, None] >> shifts) & 1).astype(np.uint8).reshape(-1)


def _unpack(packed: bytes, start: int, count: int, width: int) -> Int32:
    """(count,) indices from the start-th on."""
    first = start * width // 8
    last = ((start + count) * width + 7) // 8
    bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8, count=last - first, offset=first))
    skip = start * width - 8 * first
    table = bits[skip : skip + count * width].reshape(count, width)
    indices = np.zeros(count, dtype=np.int32)
    for column in table.T:
        indices = (indices << 1) | column
    return indices


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


def _read_args(data: bytes, *, file: str) -> tuple[list[str], int, int]:
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
