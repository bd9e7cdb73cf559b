"""One copy, no key: what takes a mark out by smoothing, shaking and training, and what burdens the reader.

Purification in the sense of diffusion purification (Nie et al. 2022): the look is damaged on purpose, then bought back
by training, which has no reason to bring the mark back.
"""

import numpy as np

from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.attack import Attacks
from engine.lab.sim.capture.trainer import TrainConfig, Trainer
from engine.lab.sim.model_placement import join
from engine.model import Float64, GaussianModel
from engine.watermark.grain import ATTRIBUTES, Grain, roughen

ATTACKS: Attacks[GaussianModel] = Attacks("model")

SHAKE = 2.0  # standard deviation of a center's move before the training, in the Gaussian's own size along each axis
STEPS = 100  # of Adam
VIEWS, VIEW_SIZE = 24, 320  # the thief's own, and their side in pixels
RATES = TrainConfig(position_rate=1.6e-4, position_rate_end=1.6e-5, scale_rate=0.005, color_rate=0.01)

UNDRAWN = 1.0 / 300.0  # opacity that no viewer draws: they begin at 1/255
TWIN = 0.5  # standard deviation of a twin's place and log sizes from those of its model, in the Gaussian's own size


def smooth(model: GaussianModel, neighbours: int) -> GaussianModel:
    """Every colour the mean of its neighbours', itself among them."""
    from scipy.spatial import cKDTree

    near = cKDTree(model.means).query(model.means, k=min(neighbours, len(model)), workers=2)[1]
    colors = model.sh[near.reshape(len(model), -1), 0]  # (N, neighbours, 3)
    return model.with_dc(colors.mean(axis=1))


def rattle(model: GaussianModel, sigma: float, rng: np.random.Generator) -> GaussianModel:
    """Centres and sizes moved at random, `sigma` in each Gaussian's own size."""
    moves: Float64 = rng.standard_normal((len(model), ATTRIBUTES)) * ([sigma] * 3 + [min(sigma, 1.0) / 2] * 3)
    return roughen(model, Grain(1.0, 1.0), moves.astype(np.float32))


def shake(model: GaussianModel, sigma: float, rng: np.random.Generator) -> GaussianModel:
    """Centres and sizes moved at random, and the order drawn anew."""
    return rattle(model, sigma, rng).take(rng.permutation(len(model)))


@ATTACKS.add(
    "smooth colors, shake, and train on renders of the smoothed model", "neighbors", 32, (1, 8, 16, 32, 64), "1..256"
)
def purify_train(model: GaussianModel, strength: int, rng: np.random.Generator) -> GaussianModel:
    """Colors become the mean over `strength` neighbors, which is what the thief takes pictures of; centers are shaken
    by twice their size and sizes by half, the order is drawn anew, and all parameters trained on the pictures.
    """
    from engine.raster import render

    blurred = smooth(model, strength)
    cameras = make_rig(model, VIEWS, VIEW_SIZE, VIEW_SIZE, jitter=rng.random((VIEWS, 4)))
    images = [np.clip(render(blurred, camera), 0.0, 1.0) for camera in cameras]
    start = shake(blurred, SHAKE, rng)
    config = TrainConfig(
        steps=STEPS,
        position_rate=RATES.position_rate,
        position_rate_end=RATES.position_rate_end,
        color_rate=RATES.color_rate,
        sh_degree=None,
        densify=None,
        seed=int(rng.integers(2**31)),
    )
    return Trainer(start, cameras, images, config).run()


@ATTACKS.add(
    "add near twins of every Gaussian that no viewer draws", "twins per Gaussian", 3.0, (0.25, 1.0, 3.0), "(0, 8]"
)
def chaff(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Twins have an opacity of 1/300, a place and sizes half a size away, colors alike; the order is drawn anew."""
    rows = rng.permutation(np.resize(rng.permutation(len(model)), max(1, round(strength * len(model)))))
    twins = rattle(model.take(rows), TWIN, rng)
    logit = np.float32(np.log(UNDRAWN / (1.0 - UNDRAWN)))
    noise = rng.standard_normal((len(rows), 3), dtype=np.float32) * np.float32(0.05)
    twins = twins.with_(opacity_logits=np.full(len(rows), logit)).with_dc(twins.sh[:, 0] + noise)
    return join(model, twins).take(rng.permutation(len(model) + len(rows)))
