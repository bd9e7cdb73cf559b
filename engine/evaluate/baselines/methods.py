"""The runnable methods, behind one small interface, so that any study can put them beside ours."""

from collections.abc import Sequence
from typing import Protocol

from engine.errors import InputError
from engine.evaluate.baselines.fitted import FittedPictures
from engine.evaluate.baselines.kept import Kept
from engine.evaluate.baselines.picture_marks import DctSpreadSpectrum, RivaGan
from engine.evaluate.baselines.qim import DitheredQim
from engine.evaluate.baselines.spread_spectrum import FileOrderSpreadSpectrum
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import Signs

__all__ = ["METHODS", "Kept", "Method", "find_method"]


class Method(Protocol):
    """A way to mark models. Everything is a function of its arguments: the same input gives the same bytes."""

    @property
    def name(self) -> str:
        """In tables."""

    @property
    def blind(self) -> bool:
        """Whether reading goes without the unmarked original."""

    @property
    def keyed(self) -> bool:
        """Whether another key reads something else."""

    @property
    def stands_for(self) -> str:
        """Which published class this is, and what of it is not."""

    def missing(self) -> str:
        """Why it cannot run here; empty when it can."""

    def cameras(self, original: GaussianModel) -> list[Camera]:
        """The owner's views at which pictures are read best; none for a reader of models."""

    def embed(
        self, model: GaussianModel, key: OwnerKey, message: Signs, psnr_db: float, cameras: Sequence[Camera]
    ) -> tuple[GaussianModel, Kept]:
        """Mark a model as strongly as a PSNR in the worst of some views allows.

        Returns
        -------
        marked : GaussianModel
        kept : Kept
            What the owner keeps for reading.
        """

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64 | None:
        """(B,) scores whose signs are the bits; None for a method that reads no models."""

    def read_picture(self, picture: Float32, kept: Kept) -> Float64 | None:
        """(B,) scores from one picture (H, W, 3) in 0..1; None for a method that reads no pictures."""


METHODS: dict[str, Method] = {
    "qim": DitheredQim(),
    "spread": FileOrderSpreadSpectrum(),
    "dct": FittedPictures(
        "DCT mark in renders, fitted",
        DctSpreadSpectrum(),
        "the class HiDDeN+3DGS: a mark in every training picture, the model fitted to them. HiDDeN's weights cannot "
        "be had; a classic blind DCT mark stands in",
    ),
    "rivagan": FittedPictures(
        "RivaGAN in renders, fitted",
        RivaGan(),
        "the class HiDDeN+3DGS with a trained network: RivaGAN of invisible-watermark",
    ),
}
"""By short name; the first two mark models at once, the others need half a minute and more."""


def find_method(name: str) -> Method:
    """The method of that short name."""
    if name not in METHODS:
        raise InputError(f"no method is called {name!r}; there are {', '.join(METHODS)}")
    return METHODS[name]
