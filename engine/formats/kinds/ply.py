"""PLY, plain and compressed, see `engine.formats.ply`."""

import numpy as np

from engine.formats.declaration import Kind, Range
from engine.formats.ply.compressed import is_compressed, read_compressed_ply, rounded, write_compressed_ply
from engine.formats.ply.gaussians import read_ply, write_ply
from engine.formats.ply.header import parse_header


def _is_ply(data: bytes, file: str, compressed: bool) -> bool:
    return data.startswith((b"ply\n", b"ply\r")) and is_compressed(parse_header(data, file=file)) is compressed


KINDS = (
    Kind(
        "ply",
        lambda data, file: _is_ply(data, file, compressed=False),
        lambda data, file, _: read_ply(data, file=file),
        write_ply,
        holds=("harmonics", "discs", "antialiasing", "properties", "comments", "origin"),
    ),
    Kind(
        "compressed.ply",
        lambda data, file: _is_ply(data, file, compressed=True),
        lambda data, file, _: read_compressed_ply(data, file=file),
        lambda model: [write_compressed_ply(model)],
        holds=("harmonics", "discs", "antialiasing", "comments"),
        ranges=(Range("sizes", -20.0, 20.0, 0.0), Range("harmonics", -4.0, 4.0, 1 / 16)),
        rounded=lambda means: rounded(means, means, (2047, 1023, 2047)),
        colors=lambda model: rounded(model.sh[:, 0], model.means, (255, 255, 255)),
        step=lambda means: float(np.ptp(means, axis=0).max()) / 2047,  # of the chunk that holds the stray
    ),
)
