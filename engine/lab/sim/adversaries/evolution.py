"""Evolving a mark away without knowing it: GMEA's idea ("Fading the Digital Ink", AAAI 2026).

The attacker has no detector, splits the Gaussians into ten groups by k-means and lets a genetic search find, for
each group, how much of it to prune and how to shift its color, such that features of the renders carry as little
variance as possible while the look stays within a budget of PSNR.

GMEA's features are maps of a network; here they are the detail bands of a three-level Haar transform of the render,
which is where a network's first layers look, too. The search is (mu + lambda) evolution with a mutation step that
follows the rule of one fifth (Rechenberg), from the unharmed model on, so that its answer always meets the budget.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.attack import Attacks
from engine.model import Camera, Float32, Float64, GaussianModel

ATTACKS: Attacks[GaussianModel] = Attacks("model")

GROUPS = 10  # k-means groups, as GMEA's
LARGEST_PRUNE = 0.5  # of any one group
LEVELS = 3


@dataclass(frozen=True)
class Budget:
    """What the search may spend."""

    generations: int = 16
    parents: int = 4  # mu
    children: int = 8  # lambda
    views: int = 2  # renders by which a candidate is judged
    size: int = 128  # their side, pixels


@dataclass(frozen=True, eq=False)
class _Judge:
    """Fitness of a genome: lower is better."""

    model: GaussianModel
    group: np.ndarray
    rank: Float64
    cameras: Sequence[Camera]
    clean: Sequence[Float32]
    floor_db: float

    def express(self, genome: Float64) -> GaussianModel:
        """The model that a genome (GROUPS, 4) stands for: share pruned, then shift of DC in R, G, B."""
        keep = self.rank >= genome[self.group, 0]
        keep[int(np.argmax(self.rank))] = True
        shift = genome[self.group, 1:].astype(np.float32)
        return self.model.with_dc(self.model.sh[:, 0] + shift).take(keep)

    def __call__(self, genome: Float64) -> float:
        from engine.numerics.image_metrics import psnr
        from engine.raster import render

        candidate = self.express(genome)
        variance, error = 0.0, 0.0
        for camera, clean in zip(self.cameras, self.clean, strict=True):
            image = np.clip(render(candidate, camera), 0.0, 1.0)
            variance += _detail_variance(image) / max(_detail_variance(clean), 1e-12) / len(self.cameras)
            error = max(error, 10.0 ** (-psnr(clean, image) / 10.0))
        excess = max(0.0, 10.0 * np.log10(max(error, 1e-12)) + self.floor_db)  # dB beyond the budget
        return float(variance + 10.0 * excess)


@ATTACKS.add(
    "prune and shift colors as a genetic search finds best",
    "least PSNR, dB",
    30.0,
    (45, 40, 35, 30, 25, 20),
    "(0, inf)",
)
def evolve(
    model: GaussianModel, strength: float, rng: np.random.Generator, *, budget: Budget = Budget()
) -> GaussianModel:
    """The PSNR is that of the attacked renders against the marked ones, in the worst view of the search."""
    from engine.raster import render

    rig = make_rig(model, budget.views, budget.size, budget.size, jitter=rng.random((budget.views, 4)))
    clean = [np.clip(render(model, camera), 0.0, 1.0) for camera in rig]
    judge = _Judge(model, _groups(model, rng), rng.random(len(model)), rig, clean, strength)
    start = np.zeros((GROUPS, 4))
    population = [(judge(start), start)]
    # A first step that alone would cost about the budget: a color error e has a PSNR of -20 log10 e.
    step = 3.5 * 10.0 ** (-strength / 20.0)
    for _ in range(budget.generations):
        brood = []
        for _ in range(budget.children):
            one, other = (population[int(rng.integers(len(population)))] for _ in range(2))
            child = np.where(rng.random((GROUPS, 1)) < 0.5, one[1], other[1])
            child = child + step * rng.standard_normal(child.shape) * (rng.random(child.shape) < 0.5)
            child[:, 0] = np.clip(child[:, 0], 0.0, LARGEST_PRUNE)
            brood.append((judge(child), child))
        better = sum(fitness < population[0][0] for fitness, _ in brood)
        step *= 1.3 if better > len(brood) / 5 else 0.8
        population = sorted([*population, *brood], key=lambda member: member[0])[: budget.parents]
    return judge.express(population[0][1])


def _groups(model: GaussianModel, rng: np.random.Generator) -> np.ndarray:
    """(N,) k-means group of each Gaussian, by position and color."""
    from scipy.cluster.vq import kmeans2
    from scipy.spatial import cKDTree

    features = np.concatenate([model.means, model.sh[:, 0]], axis=1).astype(np.float64)
    features /= np.maximum(features.std(axis=0), 1e-9)
    sample = features[np.sort(rng.permutation(len(features))[:20_000])]
    centers = kmeans2(sample, min(GROUPS, len(sample)), seed=rng, minit="++", missing="warn")[0]
    return np.asarray(cKDTree(centers).query(features, workers=2)[1])


def _detail_variance(image: Float32) -> float:
    """Sum over levels of the mean energy of the detail bands."""
    from engine.numerics.wavelet import dwt2

    return float(sum(np.mean(np.square(band)) for bands in dwt2(image, LEVELS)[1] for band in bands))
