"""Blur of a picture along a line (a moving camera) or by a lens, estimated against a render of the reference.

Both kernels are symmetric and have a transfer function of a few numbers: a line of L pixels sinc(L f), f along it, a
lens exp(-2 pi^2 sigma^2 f^2). The candidate under which the render explains most of the picture's spectrum is taken,
where it explains clearly more than the sharp render does. Picture and unmarked reference alone decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Float32, Float64

__all__ = ["Blur", "find_blur"]

LINES = (4.0, 6.0, 8.0, 11.0, 15.0, 20.0)
LENSES = (0.8, 1.1, 1.5, 2.0, 2.6, 3.4)
"""Lengths and deviations that are tried first, pixels."""
ANGLES = 12
"""Directions that are tried first, over half a turn."""
GLANCE = ((6.0, 6), (14.0, 6)), (1.2, 2.4)
"""What is tried at a glance: lines of so many pixels in so many directions, and lenses."""
PROMISING, CLEAR = 0.85, 0.6
"""Share of what the sharp render leaves unexplained that the best of a glance, and of the search, may leave."""
COARSEST, FINEST = 1.0 / 80.0, 0.25
"""Frequencies, cycles a pixel, that are looked at: below lies uneven light, above little but noise."""
LEAST_PIXELS = 4_096
ROUNDS = 4
"""Rounds of refining a candidate, each with half the steps of the one before."""

Complex = npt.NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class Blur:
    """A symmetric kernel; applied to a picture and to a gradient alike, being its own adjoint but for the borders."""

    length: float  # of a line, pixels; 0 of a lens
    angle: float  # of the line, radians from the x axis towards y
    sigma: float  # of a lens, pixels; 0 of a line

    @property
    def kernel(self) -> Float32:
        """(2 r + 1, 2 r + 1) float32 of sum 1."""
        radius = int(np.ceil(max(self.length / 2.0 + 1.0, 3.5 * self.sigma)))
        at = np.arange(-radius, radius + 1, dtype=np.float64)
        y, x = at[:, None], at[None]
        if self.sigma > 0:
            values = np.exp(-(x**2 + y**2) / (2.0 * self.sigma**2))
        else:
            values = np.zeros((len(at), len(at)))
            points = np.linspace(-0.5, 0.5, 8 * (2 * radius + 1)) * self.length
            for px, py in zip(points * np.cos(self.angle), points * np.sin(self.angle), strict=True):
                values += np.clip(1.0 - np.abs(x - px), 0.0, 1.0) * np.clip(1.0 - np.abs(y - py), 0.0, 1.0)
        return np.asarray(values / values.sum(), dtype=np.float32)

    def apply(self, image: Float32) -> Float32:
        """(H, W, C) blurred, borders mirrored."""
        import cv2

        return np.asarray(cv2.filter2D(image, -1, self.kernel, borderType=cv2.BORDER_REFLECT), dtype=np.float32)

    def transfer(self, fx: Float64, fy: Float64) -> Float64:
        """What is left of each frequency, cycles a pixel."""
        if self.sigma > 0:
            return np.asarray(np.exp(-2.0 * np.pi**2 * self.sigma**2 * (fx**2 + fy**2)))
        return np.asarray(np.sinc(self.length * (fx * np.cos(self.angle) + fy * np.sin(self.angle))))


def find_blur(reference: Float32, picture: Float32, mask: Bool) -> Blur | None:
    """The blur of a picture (H, W, 3) in the pixels of a render (H, W, 3), by what its mask (H, W) shows; None where it
    is as sharp as the render, or nearly."""
    if mask.sum() < LEAST_PIXELS:
        return None
    spectrum = _Spectrum(reference, picture, mask)
    sharp = spectrum.unexplained(None)
    (lines, lenses) = GLANCE
    glance = [Blur(0.0, 0.0, sigma) for sigma in lenses]
    glance += [Blur(length, np.pi * k / count, 0.0) for length, count in lines for k in range(count)]
    if min(map(spectrum.unexplained, glance)) > PROMISING * sharp:
        return None
    best = min(_candidates(), key=spectrum.unexplained)
    for number in range(ROUNDS):
        best = min(_around(best, 0.5**number), key=spectrum.unexplained)
    return best if spectrum.unexplained(best) < CLEAR * sharp else None


def _candidates() -> Iterator[Blur]:
    for sigma in LENSES:
        yield Blur(0.0, 0.0, sigma)
    for length in LINES:
        for k in range(ANGLES):
            yield Blur(length, np.pi * k / ANGLES, 0.0)


def _around(blur: Blur, step: float) -> Iterator[Blur]:
    """A candidate, and those about so large a part of the first steps away."""
    yield blur
    if blur.sigma > 0:
        yield from (Blur(0.0, 0.0, blur.sigma * times) for times in (1.0 - 0.15 * step, 1.0 + 0.15 * step))
        return
    turn = step * np.pi / (2 * ANGLES)
    for times in (1.0 - 0.15 * step, 1.0, 1.0 + 0.15 * step):
        for angle in (blur.angle - turn, blur.angle, blur.angle + turn):
            yield Blur(blur.length * times, float(angle), 0.0)


class _Spectrum:
    """Brightness of render and picture inside the mask, by frequency."""

    def __init__(self, reference: Float32, picture: Float32, mask: Bool) -> None:
        import cv2

        weight = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 6.0, borderType=cv2.BORDER_CONSTANT)
        weight = np.clip(2.0 * weight - 1.0, 0.0, 1.0)
        known, shown = (image.mean(axis=2) for image in (reference, picture))
        total = float(weight.sum()) or 1.0
        known, shown = (image - float((weight * image).sum()) / total for image in (known, shown))
        fy, fx = np.fft.fftfreq(mask.shape[0])[:, None], np.fft.rfftfreq(mask.shape[1])[None]
        size = np.hypot(fx, fy)
        looked_at = (size > COARSEST) & (size < FINEST)
        self._known, self._shown = (np.fft.rfft2(weight * image)[looked_at] for image in (known, shown))
        self._fx, self._fy = (np.broadcast_to(f, size.shape)[looked_at] for f in (fx, fy))
        self._energy = float(np.square(np.abs(self._shown)).sum())

    def unexplained(self, blur: Blur | None) -> float:
        """Energy of the picture that the render, blurred so and at the best contrast, does not explain."""
        seen: Complex = self._known if blur is None else self._known * blur.transfer(self._fx, self._fy)
        energy = float(np.square(np.abs(seen)).sum())
        along = float((seen.conj() * self._shown).real.sum())
        return self._energy - along**2 / energy if energy > 0 else self._energy
