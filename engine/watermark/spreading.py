"""Which bit and which secret sign each chip carries (DESIGN 4.5): all of it from the owner's key.

A chip of the tint is one code vector in one carrier direction; their flat order is stage, code vector, direction. Those
of the grain follow, see `grain`.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.model import Float64, Int32
from engine.watermark.grain import ATTRIBUTES
from engine.watermark.keys import ASSIGNMENT, CHIPS, GRAIN, OwnerKey, keystream, permutation, signs


@dataclass(frozen=True, eq=False)
class Spreading:
    """bit_of (C,) int32 in 0..bits-1 and chips (C,) int8 of +-1, for C chips in flat order."""

    bit_of: Int32
    chips: npt.NDArray[np.int8]

    def signs(self, message: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
        """(C,) +-1 of each chip's displacement: chip times the sign of its bit (message of +-1)."""
        return self.chips * message[self.bit_of]

    def then(self, other: "Spreading") -> "Spreading":
        """Both, the other's chips behind."""
        return Spreading(np.concatenate([self.bit_of, other.bit_of]), np.concatenate([self.chips, other.chips]))


def spread(key: OwnerKey, context: bytes, codes: tuple[int, ...], directions: int, bits: int) -> Spreading:
    """Deal the bits to the code vectors and draw the chips.

    Bits are dealt like cards: each run of `bits` neighbouring code vectors holds every bit once, in keyed order. So any
    piece of the scene carries the whole message, and every bit gets the same evidence.

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
    return Spreading(np.repeat(dealt, directions), signs(chip_key, total * directions))


def grain_key(key: OwnerKey, context: bytes) -> bytes:
    """The sub-key from which the grain of one copy is drawn; `context` as in `spread`."""
    return key.derive(GRAIN, context)


def spread_grain(subkey: bytes, gaussians: int, bits: int) -> Spreading:
    """Deal the bits to the Gaussians and draw the chips of the grain, so that every part of a model carries every bit.

    Parameters
    ----------
    subkey : bytes
        See `grain_key`.
    """
    dealt = keystream(subkey, 2 * gaussians, "bits").view("<u2") % np.uint16(bits)
    return Spreading(np.repeat(dealt.astype(np.int32), ATTRIBUTES), signs(subkey, ATTRIBUTES * gaussians))


def public_signs(chips: int) -> Float64:
    """(chips,) +-1 that are public: they stand for a key's signs where these must not be used."""
    return np.asarray(2.0 * np.random.default_rng(0).integers(0, 2, chips, dtype=np.int8) - 1.0, dtype=np.float64)


def signed_amplitudes(amplitudes: Float64, spreading: Spreading, message: npt.NDArray[np.int8]) -> Float64:
    """(C,) displacement of each chip: amplitude times chip times the sign of its bit (message of +-1)."""
    return amplitudes * spreading.signs(message)
