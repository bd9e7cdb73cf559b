"""The verification flow: suspect -> registration -> displacements -> claim. One decoder for all evidence.

Routes: `model` (the suspect's Gaussians against the reference's), `render` (the suspect model seen at the pose key
as a black box), `image` (pictures whose camera is known, or found). The steps are those of `searching`.
"""

from collections.abc import Sequence

from engine.model import Camera, Float32, GaussianModel
from engine.pipeline.judging import VerifyConfig
from engine.pipeline.progress import Progress
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.searching import Suspect, Verification, verify

__all__ = ["Verification", "VerifyConfig", "verify_images", "verify_model"]


def verify_model(
    suspect: GaussianModel, opened: OpenedRecord, config: VerifyConfig | None = None, progress: Progress | None = None
) -> Verification:
    """Does this model carry the record's mark? See `searching.verify`."""
    return verify(Suspect(suspect), opened, config, progress)


def verify_images(
    images: Sequence[Float32],
    opened: OpenedRecord,
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Do these pictures, all together, show a model that carries the record's mark? See `searching.Suspect`."""
    return verify(Suspect(None, images, cameras), opened, config, progress)
