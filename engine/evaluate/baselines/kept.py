"""What the owner keeps of a marking by another method."""

from dataclasses import dataclass

from engine.model import GaussianModel
from engine.watermark.keys import OwnerKey


@dataclass(frozen=True, eq=False)
class Kept:
    """All that reading may use; each method takes what its class needs.

    Parameters
    ----------
    key : OwnerKey
        Replace it to see what a wrong key reads.
    bits : int
        Length of the message.
    strength : float
        At which it was marked, in the method's own unit.
    original : GaussianModel
        Unmarked. Blind methods take no attribute of a Gaussian from it, only the frame of the scene.
    """

    key: OwnerKey
    bits: int
    strength: float
    original: GaussianModel
