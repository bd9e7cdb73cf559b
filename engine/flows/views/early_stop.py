"""The paper's early stop (Eq 8) for a model as it comes: W^freq as its own views show it."""

from engine.compress.impact import frequency_impact, measure_impact, ranks
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.view_set import look
from engine.model import Camera, Float32, GaussianModel
from engine.raster import EarlyStop, prepare_view, sh_colors

VIEWS, SIZE = 8, 400
"""Views around the model, and their side in pixels, from which W^freq is measured."""


def early_stop(model: GaussianModel, tau: float) -> EarlyStop:
    """The stop at this tau. W is a rank in (0, 1], as in Eq 5: the paper gives its sum no unit."""
    seen = look(model, make_rig(model, VIEWS, SIZE, SIZE), lambda _: None)
    impact = measure_impact(model, seen.views, seen.images)
    return EarlyStop(ranks(frequency_impact(model, impact)).astype("float32"), tau)


def render_early(model: GaussianModel, camera: Camera, early: EarlyStop, background: float = 0.0) -> Float32:
    """(H, W, 3) as `render`, but pixels end by impact, too."""
    colors = sh_colors(model.sh, model.means, camera.position.astype("float32"))
    return prepare_view(model, camera).render(colors, background, early)[0]
