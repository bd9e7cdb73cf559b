"""Messages: hexadecimal text outside, signs of +-1 inside."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.watermark.keys import MESSAGE, OwnerKey

MIN_BITS, MAX_BITS = 16, 256

Signs = npt.NDArray[np.int8]


def message_signs(text: str) -> Signs:
    """(B,) +-1 of a hexadecimal message, most significant bit first, a set bit as +1.

    InputError if the text is not hexadecimal or does not hold 16 to 256 bits in whole bytes.
    """
    digits = text.strip().lower().removeprefix("0x")
    try:
        data = bytes.fromhex(digits)
    except ValueError:
        raise InputError(f"message must be hexadecimal in whole bytes, got {text!r}") from None
    check_bits(8 * len(data))
    return (np.unpackbits(np.frombuffer(data, dtype=np.uint8)).astype(np.int8) * 2 - 1).astype(np.int8)


def message_hex(signs: Signs) -> str:
    """Hexadecimal text of (B,) signs."""
    return np.packbits(np.asarray(signs) > 0).tobytes().hex()


def derive_message(key: OwnerKey, bits: int, context: bytes) -> Signs:
    """A message drawn from the owner's key for one asset and copy."""
    check_bits(bits)
    return message_signs(key.derive(MESSAGE, context)[: bits // 8].hex())


def check_bits(bits: int) -> None:
    """Refuse lengths outside 16..256 or not in whole bytes."""
    if bits % 8 or not MIN_BITS <= bits <= MAX_BITS:
        raise InputError(f"a message has {MIN_BITS} to {MAX_BITS} bits in whole bytes, got {bits}")
