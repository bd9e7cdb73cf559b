"""The runnable methods by name."""

from engine.lab.evaluate.baselines.method import Method
from engine.lab.evaluate.baselines.model_marks import DitheredQim, FileOrderSpreadSpectrum
from engine.lab.evaluate.baselines.picture_marks import FittedPictures

__all__ = ["METHODS"]

METHODS: dict[str, Method] = {
    "qim": DitheredQim(
        "QIM on DC colour",
        "the class of FlyMark (2026): dithered QIM on DC colour, keyed by quantised position. Its own choice of "
        "carriers is not public; all Gaussians carry here, and votes are soft",
    ),
    "spread": FileOrderSpreadSpectrum(
        "spread spectrum over the file index",
        "the position paper of Deng, Nakra and Wu (2026): DCT along the file's order, keyed signs, read by "
        "subtracting the original. Additive, where the paper's is multiplicative",
        informed=True,
    ),
    "dct": FittedPictures(
        "DCT mark in renders, fitted",
        "the class HiDDeN+3DGS: a mark in every training picture, the model fitted to them. HiDDeN's weights cannot "
        "be had; a classic blind DCT mark stands in",
    ),
}
"""By short name; the first two mark models at once, the last needs half a minute and more."""
