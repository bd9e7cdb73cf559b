"""The strength of a mark: as much as the worst key view stands (DESIGN 4.5)."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from engine.flows.views.view_set import ViewSet
from engine.kernels.thread_crew import thread_count
from engine.model import Camera, Float32, Float64
from engine.numerics.image_metrics import psnr, ssim

ROUNDS = 10
"""Most renders of all views."""
PATIENCE = 2
"""Rounds after which the interval is halved. SSIM falls faster than with the factor's square where splats reach over
a black background; steps that trust the square then jump to and fro across the target."""


@dataclass(frozen=True)
class Fidelity:
    """What the worst view shows, or is to show."""

    psnr_db: float
    ssim: float

    def meets(self, other: "Fidelity") -> bool:
        """Whether it is at least as good in both."""
        return self.psnr_db >= other.psnr_db and self.ssim >= other.ssim

    def room_to(self, other: "Fidelity") -> float:
        """By how much the amplitude of what is seen may be multiplied until it shows as much as another: PSNR falls by
        20 log10 of the factor, 1 - SSIM grows with its square."""
        by_psnr = 10.0 ** ((self.psnr_db - other.psnr_db) / 20.0)
        return float(min(by_psnr, np.sqrt((1.0 - other.ssim) / max(1.0 - self.ssim, 1e-12))))


@dataclass(frozen=True)
class Strength(Fidelity):
    """Factor on the displacement, and what the worst view then measures."""

    factor: float


def add_dc(sh: Float32, displacement: Float32) -> Float32:
    """(N, K, 3) colours with the DC coefficients displaced by (N, 3), or all of them by (N, 3K)."""
    marked = sh.copy()
    marked[:, : displacement.shape[1] // 3] += displacement.reshape(len(sh), -1, 3)
    return marked


def first_guess(energies: Float64, cameras: Sequence[Camera], psnr_db: float) -> float:
    """Factor at which the view of most energy, of a `Plan`'s (V, C), would have this PSNR if no chips met in pixels."""
    pixels = 3.0 * cameras[0].width * cameras[0].height
    most = max(float(energies.sum(axis=1).max()), 1e-30)
    return 10 ** (-psnr_db / 20.0) * float(np.sqrt(pixels / most))


def solve_strength(views: ViewSet, displacement: Float32, psnr_db: float, least_ssim: float, start: float) -> Strength:
    """Largest factor at which the worst view keeps both targets.

    Its measurements come from the final renders; PSNR lies within 0.05 dB above its target unless SSIM limits.

    Parameters
    ----------
    views : ViewSet
        Of the unmarked model.
    displacement : (N, 3) float32
        At factor 1.
    psnr_db, least_ssim : float
        Targets against the unmarked render.
    start : float
        First guess of the factor.
    """
    factor, above, best = start, np.inf, None
    aim = Fidelity(psnr_db + 0.02, 1.0 - 0.996 * (1.0 - least_ssim))  # a hair above both
    for number in range(ROUNDS):
        found = _measure(views, displacement, factor)
        if not np.isfinite(found.psnr_db):  # nothing in sight changes: any strength will do
            return found
        step = found.room_to(aim)
        if found.psnr_db >= psnr_db and found.ssim >= least_ssim:
            if step < 1.006:
                return found
            best = found if best is None or factor > best.factor else best
        else:
            above = min(above, factor)
        below = best.factor if best is not None else 0.0
        if below > 0.0 and above < 1.006 * below:
            break
        factor *= step
        if number >= PATIENCE and below > 0.0 and np.isfinite(above):
            factor = float(np.sqrt(below * above))
    return best if best is not None else _measure(views, displacement, factor)


def _measure(views: ViewSet, displacement: Float32, factor: float) -> Strength:
    sh = add_dc(views.model.sh, np.float32(factor) * displacement)
    found = worst_of(compare(views.images, (views.render(k, sh) for k in range(len(views.images)))))
    return Strength(found.psnr_db, found.ssim, factor)


def compare(images: Sequence[Float32], seen: Iterable[Float32]) -> list[Fidelity]:
    """Pictures (H, W, 3) against images, each by itself; while one is compared, the next is drawn."""
    with ThreadPoolExecutor(max_workers=thread_count()) as pool:
        found = [pool.submit(_compare, image, picture) for image, picture in zip(images, seen, strict=True)]
        return [each.result() for each in found]


def _compare(image: Float32, picture: Float32) -> Fidelity:
    return Fidelity(psnr(image, picture), ssim(image, picture))


def worst_of(views: Sequence[Fidelity]) -> Fidelity:
    """The least of both among views."""
    return Fidelity(min(view.psnr_db for view in views), min(view.ssim for view in views))
