"""Connected patches of changed Gaussians, described in terms a person can use."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.lab.sim.edits.edit import Recoloring
from engine.model import SH_C0, Float64, Int64
from engine.numerics.umeyama import Similarity

__all__ = ["EditedRegion", "describe", "doubt", "group"]

LINKS = 8  # neighbours by which Gaussians of a patch hang together
REACH = 4.0  # links longer than this many median links join nothing


@dataclass(frozen=True, eq=False)
class EditedRegion:
    """A patch of one kind of change."""

    kind: str  # "recolored", "moved", "copied", "foreign" or "removed"
    rows: Int64  # (n,) Gaussians of the suspect; of the reference where removed
    center: Float64  # (3,) median of the centres, in the suspect's frame
    radius: float  # 90 % quantile of the distance from it, units of the suspect
    # new colour = gain * old colour + tint, robustly fitted; None where nothing was matched
    recoloring: Recoloring | None
    mark_left: float  # how much of the mark the patch still shows (1 all, 0 none); NaN where nothing was matched
    mark_error: float  # standard error of that
    motion: Similarity | None  # of moved and copied patches: x_now = scale * R @ x_before + t, in the suspect's frame

    def summary(self) -> str:
        """One line for a person."""
        at = ", ".join(f"{v:.3g}" for v in self.center)
        text = f"{len(self.rows)} Gaussians within {self.radius:.3g} of ({at}) {self.kind}"
        if self.motion is not None:
            turn = np.degrees(np.arccos(np.clip((np.trace(self.motion.R) - 1.0) / 2.0, -1.0, 1.0)))
            text += f" by scale {self.motion.scale:.3g} and {turn:.3g} degrees"
        if self.kind == "recolored" and self.recoloring is not None:
            gain, tint = (", ".join(f"{v:.2f}" for v in x) for x in (self.recoloring.gain, self.recoloring.tint))
            text += f": gain ({gain}), tint ({tint})"
        if np.isfinite(self.mark_left):
            text += f"; mark left {self.mark_left:.2f} +- {self.mark_error:.2f}"
        return text


def group(means: Float64, rows: Int64, least: int) -> list[Int64]:
    """Patches of at least `least` rows that hang together in space, largest first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(rows) < max(least, 2):
        return []
    points = means[rows]
    k = min(LINKS + 1, len(rows))
    distance, near = cKDTree(points).query(points, k=k, workers=1)
    limit = REACH * float(np.median(distance[:, -1]))
    i, j = np.repeat(np.arange(len(rows)), k), near.reshape(-1)
    close = distance.reshape(-1) <= limit
    links = coo_matrix((np.ones(int(close.sum())), (i[close], j[close])), shape=(len(rows), len(rows)))
    _, label = connected_components(links, directed=False)
    sizes = np.bincount(label)
    order = [c for c in np.argsort(-sizes, kind="stable") if sizes[c] >= least]
    return [rows[label == c] for c in order]


def describe(
    kind: str,
    rows: Int64,
    points: Float64,
    reference_dc: npt.NDArray[np.floating],
    suspect_dc: npt.NDArray[np.floating],
    mark: Float64,
    motion: Similarity | None,
) -> EditedRegion:
    """The description of a patch: rows (n,) at points (n, 3).

    DC before and now, and the mark's displacement, are (m, 3), of the matched ones; m may be 0.
    """
    center = np.median(points, axis=0)
    radius = float(np.quantile(np.linalg.norm(points - center, axis=1), 0.9))
    if not len(mark):
        return EditedRegion(kind, rows, center, radius, None, np.nan, np.nan, motion)
    old, new = reference_dc.astype(np.float64), suspect_dc.astype(np.float64)
    gain, offset = np.array([_line(old[:, c], new[:, c], mark[:, c]) for c in range(3)]).T  # (3,), (3,)
    rest = new - gain * old - offset
    weight = 1.0 / doubt(np.linalg.norm(rest, axis=1))
    energy = float(weight @ np.square(mark).sum(axis=1))
    left = float(weight @ (mark * rest).sum(axis=1) / max(energy, 1e-30))
    spread = float(weight @ np.square(rest - left * mark).sum(axis=1) / max(3.0 * weight.sum(), 1e-30))
    error = float(np.sqrt(spread / max(energy, 1e-30)))
    recoloring = Recoloring(gain, SH_C0 * offset - 0.5 * (gain - 1.0))
    return EditedRegion(kind, rows, center, radius, recoloring, left, error, motion)


def doubt(gap: Float64, finest: float = 1e-6) -> Float64:
    """One over the Geman-McClure weights of residuals (n,), on a scale of twice their median, `finest` at least."""
    return np.asarray((1.0 + (gap / max(2.0 * float(np.median(gap)), finest)) ** 2) ** 2)


def _line(old: Float64, new: Float64, mark: Float64) -> tuple[float, float]:
    """Robust gain and offset of new = gain * old + offset + share * mark (Geman-McClure weights)."""
    design = np.stack([old, np.ones_like(old), mark], axis=1)
    weight = np.ones(len(old))
    fit = np.array([1.0, float(np.median(new - old)), 1.0])
    for _ in range(10):
        weight = 1.0 / doubt(np.abs(new - design @ fit))
        normal = (design * weight[:, None]).T @ design + 1e-9 * len(old) * np.eye(3)
        fit = np.linalg.solve(normal, (design * weight[:, None]).T @ new)
    return float(fit[0]), float(fit[1])
