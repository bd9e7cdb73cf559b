"""Textures of meshes: which color they give a corner."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.guards import read_regular
from engine.formats.image_files import MAX_PIXELS_TOGETHER, read_picture
from engine.model import Float32, Float64


class Textures:
    """The pictures of one mesh, each decoded once, and no more of them than of one suspect's."""

    def __init__(self, file: str) -> None:
        self._file, self._left = file, MAX_PIXELS_TOGETHER
        self._decoded: dict[Path | int, Float32] = {}

    def sample(self, key: Path | int, at: npt.NDArray[np.floating], load: Callable[[], bytes] | None = None) -> Float64:
        """(N, 3) values of the pixels nearest to coordinates (N, 2), from 0 to 1 to the right and down, of a picture
        file, or of the picture that `load` brings; it repeats beyond its borders."""
        if key not in self._decoded:
            name = key.name if isinstance(key, Path) else "texture"
            content = load() if load else read_regular(Path(str(key)), name)
            self._decoded[key] = read_picture(content, name, managed=False)
            self._left -= self._decoded[key].size // 3
            if self._left < 0:
                raise FormatError(f"its textures have more than {MAX_PIXELS_TOGETHER:,} pixels", file=self._file)
        pixels = self._decoded[key]
        height, width = pixels.shape[:2]
        sound = np.where(np.isfinite(at), at, 0.0).astype(np.float64) % 1.0
        column, row = (np.minimum((sound[:, i] * n).astype(np.int64), n - 1) for i, n in ((0, width), (1, height)))
        return np.asarray(pixels[row, column], dtype=np.float64)
