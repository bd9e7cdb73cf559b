"""Image mark, then fit: mark the renders of a model and fit its colours to them; read any render again.

The recipe of HiDDeN+3DGS in the tables of the field. One fit gives a direction in the space of colours; its length is
then set by the PSNR, so that all methods stand at the same fidelity.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.evaluate.baselines.kept import Kept
from engine.evaluate.baselines.picture_marks import PictureMark
from engine.evaluate.baselines.strength import at_psnr
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.pipeline.rigs import make_rig
from engine.raster import render
from engine.sim.fine_tuning import fine_tune
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import Signs

__all__ = ["FittedPictures"]


@dataclass(frozen=True)
class FittedPictures:
    """A picture mark in every training view, and a model whose colours were fitted to them.

    Parameters
    ----------
    views : int
        Training views, a regular rig about the original.
    size : int
        Pixels a side.
    epochs : int
        Rounds of the fit over all views.
    read_views : int
        Of the training views, how many a model is read at; their scores are summed.
    """

    name: str
    mark: PictureMark
    stands_for: str
    views: int = 12
    size: int = 512
    epochs: int = 20
    read_views: int = 4
    blind: bool = True

    @property
    def keyed(self) -> bool:
        """As the picture mark."""
        return self.mark.keyed

    def missing(self) -> str:
        """What the picture mark lacks."""
        return self.mark.missing()

    def cameras(self, original: GaussianModel) -> list[Camera]:
        """The training views: where a picture is read best."""
        return make_rig(original, self.views, self.size, self.size)

    def embed(
        self, model: GaussianModel, key: OwnerKey, message: Signs, psnr_db: float, cameras: Sequence[Camera]
    ) -> tuple[GaussianModel, Kept]:
        """See `Method`; the strength is a factor on the fitted change of colours."""
        training = self.cameras(model)
        pictures = [self.mark.encode(np.clip(render(model, camera), 0.0, 1.0), key, message) for camera in training]
        fitted = fine_tune(model, training, pictures, self.epochs, trained="colors")
        change = fitted.sh - model.sh

        def colors_at(factor: float) -> Float32:
            return np.asarray(model.sh + np.float32(factor) * change)

        marked, factor = at_psnr(model, cameras, psnr_db, colors_at, 1.0)
        return marked, Kept(key, len(message), factor, model)

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64:
        """See `Method`: 8-bit renders of the suspect at the owner's training views, wherever it was moved to."""
        found = [
            self.read_picture(_stored(render(suspect, camera)), kept)
            for camera in self.cameras(kept.original)[:: max(1, self.views // self.read_views)]
        ]
        return np.asarray(np.sum(found, axis=0))

    def read_picture(self, picture: Float32, kept: Kept) -> Float64:
        """See `Method`."""
        return self.mark.decode(picture, kept.key, kept.bits)


def _stored(image: Float32) -> Float32:
    return (np.round(np.clip(image, 0.0, 1.0) * 255.0) / 255.0).astype(np.float32)
