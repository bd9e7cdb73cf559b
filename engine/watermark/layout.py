"""The layout of a mark: which code vectors exist, their carriers, and how far each chip is displaced."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from engine.model import Float32, Float64, Int32, Int64

Values = npt.NDArray[np.float32] | npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Layout:
    """All stages of a mark. It is made from the unmarked model alone and holds no chip."""

    labels: tuple[Int32, ...]  # (N,) each: code of each Gaussian in each stage
    codes: tuple[int, ...]  # number of code vectors of each stage
    # (R, D) each: carriers of each stage; R and D are those of all. D is 3, DC space, or 3K of all coefficients
    directions: tuple[Float64, ...]
    amplitudes: Float64  # (C,) size of each chip's displacement, SH units; flat order stage, code vector, carrier
    # (N,) how many times its code vectors' displacements each Gaussian takes, so that no two are displaced alike; None:
    # one time
    multiples: Float32 | None = None

    @property
    def chips(self) -> int:
        """Number of chips C."""
        return sum(self.codes) * len(self.directions[0])

    @property
    def width(self) -> int:
        """Numbers D of a Gaussian's colour that the mark displaces: the first 3, or all."""
        return int(self.directions[0].shape[1])

    def at(self, rows: Int64 | Int32) -> "Layout":
        """Of these Gaussians alone."""
        labels = tuple(label[rows] for label in self.labels)
        return replace(self, labels=labels, multiples=None if self.multiples is None else self.multiples[rows])

    def split(self, flat: Float64) -> list[Float64]:
        """(C,) per chip -> one (codes, R) array per stage."""
        carriers = len(self.directions[0])
        ends = np.cumsum(self.codes)[:-1] * carriers
        return [part.reshape(-1, carriers) for part in np.split(flat, ends)]

    def displace(self, signed: Float64) -> Float32:
        """(N, D) displacement of each Gaussian's colour for the displacements (C,) of the chips.

        c'_k = c_k + sum_r signed_kr v_r (Eq 6's minimum under a fixed linear response), summed over the stages.
        """
        total = np.zeros((len(self.labels[0]), self.width))
        for part, label, direction in zip(self.split(signed), self.labels, self.directions, strict=True):
            total += (part @ direction)[label]
        if self.multiples is not None:
            total *= self.multiples[:, None]
        return total.astype(np.float32)

    def gather(self, per_gaussian: Values) -> Float64:
        """(C,) adjoint of `displace`: sums a gradient (N, D) with respect to the colours over each chip; of one (N, 3)
        with respect to DC, the DC part of the carriers is taken."""
        flat, width = [], per_gaussian.shape[1]
        if self.multiples is not None:
            per_gaussian = per_gaussian * self.multiples[:, None]
        for count, label, direction in zip(self.codes, self.labels, self.directions, strict=True):
            sums = [np.bincount(label, per_gaussian[:, c], count) for c in range(width)]
            flat.append((np.stack(sums, axis=1) @ direction[:, :width].T).reshape(-1))
        return np.concatenate(flat)
