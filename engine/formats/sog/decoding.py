"""From the images of a SOG scene to the attributes of Gaussians."""

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.guards import check_count
from engine.formats.modes import with_mode
from engine.formats.repairs import Repair, clean
from engine.formats.smallest_three import put_together
from engine.formats.sog.archive import Archive
from engine.formats.sog.images import REENCODED, Pixels, decode_lossless, lossless_size
from engine.formats.sog.meta import MAX_PALETTE, PALETTE_ROW, REST_COEFFICIENTS, Palette, SogMeta
from engine.model import Float32, GaussianModel

QUATERNION_TAG = 252
"""Alpha of a quaternion's pixel: this plus the index of the component that is left out, the largest."""

_IMPOSSIBLE, _MOST_IMPOSSIBLE = 0.02, 0.01
"""By how much a component may be larger than the one left out, which is the largest, and in which share of the rows:
8 bits and the writers of SOG reach 0.015 in all but 1 in 100,000 rows, packing with loss 0.02 in 3 to 5 %."""
_FEW = 64  # Gaussians of which all may be turned half about one axis, or nearly

_SAMPLE, _PALETTE = 1 << 16, 256
_FEW_ODD = 0.25
"""Share of the different centers along an axis: half of them in real scenes, 1 in 50 once packed near-losslessly."""

_CHUNK = 1 << 14


def decode_scene(meta: SogMeta, archive: Archive, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Decode all images of a scene; see `engine.formats.sog.bundle.read_sog`."""
    check_count(meta.count, archive.size, file=file)
    scene = _Scene(meta, archive, file)
    sh0 = scene.rows("sh0")
    quats, quat_repairs = scene.quats()
    logits, dc = meta.opacity.astype(np.float32)[sh0[:, 3]], _look_up(meta.dc, sh0)
    rest, rest_repairs = scene.rest()
    sh = dc[:, None] if rest is None else np.concatenate([dc[:, None], rest], axis=1)  # (N, K, 3)
    means, log_scales = scene.means(), _look_up(meta.scales, scene.rows("scales"))
    model, repairs = clean(means, log_scales, quats, logits, sh, file=file, element="gaussians")
    return with_mode(model, meta.mode), (*meta.repairs, *quat_repairs, *rest_repairs, *repairs)


class _Scene:
    """Images are decoded at first use, each once; all of one Gaussian a pixel have one size."""

    def __init__(self, meta: SogMeta, archive: Archive, file: str) -> None:
        self._meta, self._archive, self._file = meta, archive, file
        self._size: tuple[int, int] | None = None
        self._pixel_limit = 2 * meta.count + (1 << 16)  # writers pad to blocks or to a square

    def _load(self, name: str, pixel_limit: int) -> tuple[bytes, tuple[int, int]]:
        # A lossless image is hardly ever larger than its four bytes a pixel.
        data = self._archive.read(name, 6 * pixel_limit + (1 << 16))
        size = lossless_size(data, file=self._file, element=name)
        if size[0] * size[1] > pixel_limit:
            raise self._fault(f"{size[0]}x{size[1]} pixels, at most {pixel_limit} expected", name)
        return data, size

    def _fault(self, message: str, name: str) -> FormatError:
        return FormatError(f"{message}; {REENCODED}", file=self._file, element=name)

    def rows(self, key: str, index: int = 0) -> Pixels:
        """(N, 4) the pixels of the Gaussians in one image."""
        name, count = self._meta.files[key][index], self._meta.count
        data, size = self._load(name, self._pixel_limit)
        if size[0] * size[1] < count:
            raise self._fault(f"{size[0]}x{size[1]} pixels for {count} Gaussians", name)
        if self._size not in (None, size):
            raise self._fault(f"is {size[0]}x{size[1]}, other images are {self._size[0]}x{self._size[1]}", name)
        self._size = size
        pixels = decode_lossless(data, size, file=self._file, element=name).reshape(-1, 4)
        if key == "quats":
            self._check_quats(pixels, name)
        return pixels[:count]

    def _check_quats(self, pixels: Pixels, name: str) -> None:
        """That rotations are there for as many Gaussians as meta.json counts, and such that they can be."""
        count, size = self._meta.count, self._size or (0, 0)
        beyond = int(np.count_nonzero(pixels[count:, 3] >= QUATERNION_TAG))
        if beyond > 4 * sum(size):  # writers pad to multiples of 4
            said = f"{beyond} of them rotations beyond the {count} Gaussians of meta.json"
            raise self._fault(f"{size[0]}x{size[1]} pixels, {said}", name)
        small = (pixels[:count, :3] / np.float32(127.5) - 1) * np.float32(np.sqrt(0.5))
        largest = np.sqrt(np.maximum(1 - np.einsum("nc,nc->n", small, small), 0))
        wrong = float(np.mean(np.abs(small).max(axis=1) > largest + _IMPOSSIBLE))
        if wrong > _MOST_IMPOSSIBLE:
            raise self._fault(f"{wrong:.0%} of the pixels are no rotations, or meta.json counts too many", name)
        if count > _FEW and (pixels[:count, 3] == 255).all() and np.ptp(pixels[:count, :3]) > 0:
            raise self._fault("its transparency, which says what component each rotation leaves out, is gone", name)

    def means(self) -> Float32:
        low, high, names = self.rows("means", 0), self.rows("means", 1), self._meta.files["means"]
        some = np.ascontiguousarray(low[:_SAMPLE, :3])
        if len(some) > 4 * _PALETTE >= 4 * len(np.unique(some.view("V3"))):
            raise self._fault("holds no more values than a palette", names[0])
        result, even = np.empty((self._meta.count, 3), dtype=np.float32), 0
        for axis in range(3):
            code = low[:, axis] | (high[:, axis].astype(np.uint16) << 8)
            values = np.unique(code[:_SAMPLE])
            even += bool(len(values) > _PALETTE and np.mean(values & 1) < _FEW_ODD)
            ramp = np.linspace(self._meta.mins[axis], self._meta.maxs[axis], 1 << 16)
            with np.errstate(over="ignore"):  # an absurd range becomes infinite, and its rows are dropped
                table = (np.sign(ramp) * np.expm1(np.abs(ramp))).astype(np.float32)
            result[:, axis] = table[code]
        if even == 3:
            raise self._fault("its numbers are nearly all even, as near-lossless WebP leaves them", names[0])
        return result

    def quats(self) -> tuple[Float32, tuple[Repair, ...]]:
        pixels = self.rows("quats")
        tagged = pixels[:, 3] >= QUATERNION_TAG
        largest = np.where(tagged, pixels[:, 3] - np.uint8(QUATERNION_TAG), 0)
        table = ((np.arange(256) / 127.5 - 1.0) * np.sqrt(0.5)).astype(np.float32)
        small = table[pixels[:, :3]]  # (N, 3)
        quats = put_together(small, largest)
        untagged = np.flatnonzero(~tagged)
        if not len(untagged):
            return quats, ()
        quats[untagged] = np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32)
        text = f"{len(untagged)} quaternions (first in row {untagged[0]}) without a tag taken as no rotation"
        return quats, (Repair("quaternions_untagged", len(untagged), text),)

    def rest(self) -> tuple[Float32 | None, tuple[Repair, ...]]:
        """(N, K - 1, 3) coefficients above DC, None for degree 0."""
        palette = self._meta.palette
        if palette is None:
            return None, ()
        book = self._centroids(palette)  # (P, K - 1, 3)
        count = len(book) if palette.count is None else palette.count
        pixels = self.rows("shN", 1)
        labels = pixels[:, 0] | (pixels[:, 1].astype(np.uint16) << 8)
        stray = np.flatnonzero(labels >= count)
        if len(stray):
            book = np.concatenate([book[:count], np.zeros((1, *book.shape[1:]), dtype=np.float32)])
            labels = np.minimum(labels, np.uint16(min(count, MAX_PALETTE - 1)))
        result = np.empty((len(labels), *book.shape[1:]), dtype=np.float32)
        for start in range(0, len(labels), _CHUNK):
            np.take(book, labels[start : start + _CHUNK], axis=0, out=result[start : start + _CHUNK], mode="clip")
        if not len(stray):
            return result, ()
        text = f"{len(stray)} labels (first in row {stray[0]}) beyond the {count} code vectors taken as zero"
        return result, (Repair("labels_beyond_palette", len(stray), text),)

    def _centroids(self, palette: Palette) -> Float32:
        name = self._meta.files["shN"][0]
        data, (width, height) = self._load(name, MAX_PALETTE * max(REST_COEFFICIENTS.values()))
        bands = {PALETTE_ROW * rest: band for band, rest in REST_COEFFICIENTS.items()}.get(width)
        if bands is None or palette.bands not in (None, bands):
            raise self._fault(f"{width} pixels wide, expected {PALETTE_ROW} times 3, 8 or 15, as its bands say", name)
        if PALETTE_ROW * height < (palette.count or 1) or height > MAX_PALETTE // PALETTE_ROW:
            raise self._fault(f"{height} rows of {PALETTE_ROW} code vectors for {palette.count}", name)
        pixels = decode_lossless(data, (width, height), file=self._file, element=name)
        codes: npt.NDArray[np.uint8] = pixels[..., :3].reshape(PALETTE_ROW * height, -1, 3)  # (P, K - 1, 3)
        return palette.table.astype(np.float32)[codes]


def _look_up(tables: npt.NDArray[np.float64], pixels: Pixels) -> Float32:
    """(N, 3) values of the first three channels, each through its own table."""
    result = np.empty((len(pixels), 3), dtype=np.float32)
    for channel in range(3):
        result[:, channel] = tables[channel].astype(np.float32)[pixels[:, channel]]
    return result
