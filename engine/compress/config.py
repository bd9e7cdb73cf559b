"""Tuned constants of how a model is reduced, a frozen config (DESIGN 4.2 to 4.4)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RecoveryConfig:
    """What pruning leaves, fitted to the original's renders (`recovery`).

    Work is counted, not timed, so that the bytes do not depend on the machine: nanoseconds of one core, as measured.
    """

    per_gaussian: float = 220.0  # of a picture and its gradients; so is the next
    per_pixel: float = 50.0
    least_work: float = 6e9  # that any model is worth, each of its Gaussians, and the most of a model
    work_each: float = 130e3
    most_work: float = 80e9
    views: int = 48  # fitted to, and the fewest where the original is slow to draw
    least_views: int = 12
    held_out: int = 6  # views that are neither fitted to nor the key's, and held to the budget, too
    looking: float = 0.25  # share of the work that may go into drawing them
    side: int = 800  # pixels at most: at 400 the same work gains less in views of 800
    seed: int = 0xF17  # of the views, and of their order
    hard_share: float = 0.5  # of the steps that go to views by their squared error: the worst view decides
    full_pace_db: float = 37.0  # goal up to which the rates are these, and smaller with the error beyond it
    # Steps of a round, and the factors on their rates: at full rates alone the worst view stays 1.5 dB below
    round: tuple[int, ...] = (60, 25, 15)
    paces: tuple[float, ...] = (1.0, 0.3, 0.1)
    # Adam steps: centres, in the Gaussian's own widths; unit quaternions; log scales; logits
    mean_rate: float = 0.03
    quat_rate: float = 5e-3
    scale_rate: float = 1e-2
    opacity_rate: float = 4e-2
    knee: float = 0.02  # below which an error counts by its square, of a range of 1
    stretch: float = 1.0  # most that a log scale changes: no needles
    opacity_logit: float = 7.0  # beyond which none goes that did not start there
    # Pruning by turns: how far below the budget it starts (at it, where that is not made good); PSNR that a factor of
    # e in the number of Gaussians is worth, at first and at the least and most; the least and most share that a turn
    # leaves; how far below the budget another round may do; and the gain of a round below which there is no more, dB
    heads_db: tuple[float, ...] = (7.0, 0.0)
    slope_db: float = 6.0
    slopes_db: tuple[float, float] = (3.0, 100.0)
    least_share: float = 0.65
    most_share: float = 0.98
    near_db: float = 0.7
    least_gain_db: float = 0.1


@dataclass(frozen=True)
class CodeFitConfig:
    """Code vectors fitted to the original's renders (`code_fit`)."""

    views: int = 12  # that are no key views
    side: int = 800  # pixels, of a view: at 400 unseen views gain half a dB less
    steps: int = 8  # of conjugate gradients, at most
    least_gain: float = 0.03  # share of the squared error that a step must save for another (0.13 dB)
    prior: float = 0.01  # pixels' worth of squared error that holds each Gaussian's color where it was


@dataclass(frozen=True)
class CompressConfig:
    """Uncertainty (`impact`), near-duplicates (`pruning`), `cells` and `levels_of_detail`."""

    prior: float = 1e-3  # precision of the Laplace approximation, squared blending weights: unseen ones stay finite
    color_gap: float = 0.15  # largest DC difference of a pair that may be merged, SH units (about 0.04 in color),
    shape_gap: float = 0.35  # and largest relative difference of its covariances (Frobenius)
    color_weight: float = 0.06  # of a unit of DC color against the scene's radius, where cells are split
    neighbors: int = 12  # nearest Gaussians among which a partner is sought for a coarser level of detail
    color_std: float = 0.2  # difference of SH coefficients that costs such a pair as much as half a nat of shape
    thin: float = 1e-8  # share of its trace added to a covariance, so that discs have a determinant
    recovery: RecoveryConfig = RecoveryConfig()
    code_fit: CodeFitConfig = CodeFitConfig()


CONFIG = CompressConfig()
