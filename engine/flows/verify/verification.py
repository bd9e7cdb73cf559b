"""The verification flow: suspect -> registration -> displacements -> claim. One decoder for all evidence.

Routes: `model` (the suspect's Gaussians against the reference's), `render` (the suspect model seen at the pose key
as a black box), `image` (pictures whose camera is known, or found). The steps are those of `search`.
"""

from collections.abc import Sequence

from engine.flows.progress import Progress
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.search import Suspect, Verification, verify
from engine.model import Camera, Float32, GaussianModel

__all__ = ["Verification", "VerifyConfig", "verify_images", "verify_model"]


def verify_model(
    suspect: GaussianModel, opened: OpenedRecord, config: VerifyConfig | None = None, progress: Progress | None = None
) -> Verification:
    """Does this model carry the record's mark? See `search.verify`."""
    return verify(Suspect(suspect), opened, config, progress)


def verify_images(
    images: Sequence[Float32],
    opened: OpenedRecord,
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Do these pictures, all together, show a model that carries the record's mark? See `search.Suspect`."""
    return verify(Suspect(None, images, cameras), opened, config, progress)
