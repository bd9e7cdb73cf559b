"""Which bit, which secret sign and which size each chip has (DESIGN 4.5): all of it from the owner's key.

A chip of the tint is one code vector in one carrier direction; their flat order is stage, code vector, direction. Those
of the grain follow, see `grain`. Sizes are drawn from streams of their own, so that signs are fair coins whatever the
sizes are: the theorem of `statistics` holds for evidence that was weighted by them.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Float32, Float64, Int32
from engine.watermark.grain import ATTRIBUTES
from engine.watermark.keys import ASSIGNMENT, CHIPS, GRAIN, OwnerKey, keystream, permutation, signs


@dataclass(frozen=True, eq=False)
class Spreading:
    """Bits, signs and sizes of C chips in flat order."""

    bit_of: Int32  # (C,) 0..bits-1
    chips: npt.NDArray[np.int8]  # (C,) +-1
    # (C,) by how much each displacement is more or less than its amplitude, of mean square 1; None: all alike
    sizes: Float32 | None = None

    def signs(self, message: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
        """(C,) +-1 of each chip's displacement: chip times the sign of its bit (message of +-1)."""
        return self.chips * message[self.bit_of]

    def values(self, message: npt.NDArray[np.int8]) -> Float64:
        """(C,) displacement of each chip in amplitudes: sign times size."""
        signs = self.signs(message).astype(np.float64)
        return signs if self.sizes is None else signs * self.sizes

    def then(self, other: "Spreading") -> "Spreading":
        """Both, the other's chips behind. Of both all or none have sizes."""
        sizes = None if self.sizes is None or other.sizes is None else np.concatenate([self.sizes, other.sizes])
        return Spreading(np.concatenate([self.bit_of, other.bit_of]), np.concatenate([self.chips, other.chips]), sizes)

    def of(self, rows: Bool) -> "Spreading":
        """Of some of the chips."""
        return Spreading(self.bit_of[rows], self.chips[rows], None if self.sizes is None else self.sizes[rows])


ONE_BIT = np.ones(1, dtype=np.int8)
"""The message of a copy layer: it says whose copy it is, and nothing else."""


def spread(
    key: OwnerKey, context: bytes, codes: tuple[int, ...], directions: int, bits: int, *, sized: bool = False
) -> Spreading:
    """Deal the bits to the code vectors and draw the chips.

    Bits are dealt like cards: each run of `bits` neighbouring code vectors holds every bit once, in keyed order. So any
    piece of the scene carries the whole message, and every bit gets equal evidence.

    Parameters
    ----------
    context : bytes
        Digest of the canonical reference and record id (`chip_context`): binds the chips to this asset.
    codes : tuple of int
        Code vectors of each stage. Neighbouring numbers of stage 0 are neighbours in the scene (tree order).
    directions : int
        Carriers per code vector.
    bits : int
        Length of the message.
    sized : bool
        Whether chips differ in size, too (records from format 3 on).
    """
    total = sum(codes)
    order_key, chip_key = key.derive(ASSIGNMENT, context), key.derive(CHIPS, context)
    rounds = sum(-(-count // bits) for count in codes)
    decks = permutation(order_key, rounds * bits)  # ranks within each deck are a keyed shuffle
    decks = decks.reshape(rounds, bits).argsort(axis=1).astype(np.int32)
    dealt, used = np.empty(total, dtype=np.int32), 0
    start = 0
    for count in codes:
        hands = -(-count // bits)
        dealt[start : start + count] = decks[used : used + hands].reshape(-1)[:count]
        start, used = start + count, used + hands
    sizes = drawn_sizes(chip_key, total * directions) if sized else None
    return Spreading(np.repeat(dealt, directions), signs(chip_key, total * directions), sizes)


def grain_key(key: OwnerKey, context: bytes) -> bytes:
    """The sub-key from which the grain of one copy is drawn; `context` as in `spread`."""
    return key.derive(GRAIN, context)


def spread_grain(subkey: bytes, gaussians: int, bits: int, *, sized: bool = False) -> Spreading:
    """Deal the bits to the Gaussians and draw the chips of the grain, so that every part of a model carries every bit.

    Parameters
    ----------
    subkey : bytes
        See `grain_key`.
    """
    dealt = keystream(subkey, 2 * gaussians, "bits").view("<u2") % np.uint16(bits)
    chips = ATTRIBUTES * gaussians
    sizes = drawn_sizes(subkey, chips) if sized else None
    return Spreading(np.repeat(dealt.astype(np.int32), ATTRIBUTES), signs(subkey, chips), sizes)


def drawn_sizes(subkey: bytes, count: int) -> Float32:
    """(count,) keyed sizes of mean square 1, evenly from 0.48 to 1.44: no value stands for plus or minus."""
    stream = keystream(subkey, 2 * count, "sizes").view("<u2")
    return ((stream.astype(np.float32) + np.float32(0.5)) / np.float32(1 << 16) + np.float32(0.5)) / SIZE_RMS


SIZE_RMS = np.float32(np.sqrt(13.0 / 12.0))
"""Of what is even from 0.5 to 1.5."""


def spread_copy(subkey: bytes, count: int, use: str) -> Spreading:
    """The chips of one recipient's copy: displacements drawn from a bell curve (Cox et al. 1997), without a message.

    Two copies' differences, means and extremes of such values say little of each value (Kilian et al. 1998), where
    those of a few values would give all of them away. A value is the sum of BELL even numbers of 16 bits: exact on
    every machine, within 4.2 standard deviations, and as likely to be plus as minus whatever its size.

    Parameters
    ----------
    subkey : bytes
        Of one copy: follows from its record id.
    count : int
        Number of chips.
    use : str
        Which layer they belong to: "tint" or "grain".
    """
    stream = keystream(subkey, 2 * BELL * count, use).view("<u2").reshape(count, BELL)
    sums = stream.sum(axis=1, dtype=np.int64).astype(np.float32) - np.float32(BELL * 65535 / 2)
    values = sums / np.float32(65536 * np.sqrt(BELL / 12.0))
    chips = np.where(values > 0, 1, -1).astype(np.int8)
    return Spreading(np.zeros(count, dtype=np.int32), chips, np.abs(values))


BELL = 6
"""Even numbers whose sum is near enough to a bell curve (excess kurtosis -0.2)."""


def public_values(chips: int) -> Float64:
    """(chips,) values that are public: they stand for a copy's, which must not decide a strength."""
    return np.random.default_rng(1).standard_normal(chips)


def public_signs(chips: int) -> Float64:
    """(chips,) +-1 that are public: they stand for a key's signs where these must not be used."""
    return np.asarray(2.0 * np.random.default_rng(0).integers(0, 2, chips, dtype=np.int8) - 1.0, dtype=np.float64)
