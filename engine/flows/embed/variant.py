"""What a model that is more than one plain file tells the embedding: a codebook of its own, motion, steadiness."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from engine.compress.hvq import Stage, group_means
from engine.compress.impact import Impact
from engine.errors import InputError
from engine.model import Float32, Float64, GaussianModel, Int32

AtView = Callable[[GaussianModel, int], GaussianModel]
"""From the model (or the model displaced, in color and geometry) and the number of a key view to what it sees."""


@dataclass(frozen=True, eq=False)
class Variant:
    """What an embedding does not do as it does with a plain model; the default is the plain model."""

    # (N,) colour code of each Gaussian, from 0 on, where the file has a codebook: its codes become the mark's code
    # vectors in place of cells of our own
    labels: Int32 | None = None
    # The model as key view k sees it, for instance at its moment: the same Gaussians in the same order, elsewhere.
    # Impact, strength and the report then follow what the views really show.
    at_view: AtView | None = None
    # (N,) factor on the displacement of each Gaussian's code vector (mean over the members), 0 exclusive to 1
    emphasis: Float32 | Float64 | None = None
    # Whether the file has room for a grain in its centres and sizes: no two Gaussians may share an entry of a codebook
    free_centers: bool = True
    free_sizes: bool = True
    # Digests of what verification will rely on in addition to the record. They enter its plan, so that the chips are
    # drawn after them (DESIGN 4.9).
    commitments: Mapping[str, str] = field(default_factory=dict)

    def check(self, model: GaussianModel, *, keeps_rows: bool, refines: bool) -> None:
        """Refuse what does not fit the model or the configuration.

        InputError: a length differs from the model's, a value is out of its range, the rows are to change (pruning, the
        compact output), or a moving model is to be refined.
        """
        for name, values in (("labels", self.labels), ("emphasis", self.emphasis)):
            if values is not None and values.shape != (len(model),):
                raise InputError(f"{name} has shape {values.shape}, the model {len(model)} Gaussians")
        if self.labels is not None and int(self.labels.min()) < 0:
            raise InputError(f"labels must not be negative, got {int(self.labels.min())}")
        if self.emphasis is not None and not (self.emphasis.min() > 0 and self.emphasis.max() <= 1):
            low, high = float(self.emphasis.min()), float(self.emphasis.max())
            raise InputError(f"emphasis must lie in (0, 1], got {low:g} to {high:g}")
        special = self.labels is not None or self.at_view is not None or self.emphasis is not None
        if special and not keeps_rows:
            raise InputError("a variant is marked as it is: no pruning budget and output 'fidelity'")
        if self.at_view is not None and refines:
            raise InputError("refinement sees one moment only: a moving model is marked with refine.steps = 0")

    def own_stages(self, model: GaussianModel, weights: Float64) -> tuple[Stage, ...] | None:
        """The one stage of the file's own codes, or None where there are none."""
        if self.labels is None:
            return None
        labels = np.ascontiguousarray(self.labels, dtype=np.int32)
        return (Stage(group_means(model.sh.reshape(len(model), -1), labels, weights), labels),)

    def emphasis_on(self, impact: Impact) -> Float64 | None:
        """(N,) the emphasis, and of the file's own codes less on those that cover much of the views.

        Our cells cover about as much each. A codebook learnt from colours alone has entries that half the scene
        shares (a white wall, black ground): at equal amplitude these would spend the whole fidelity on a few chips.
        Beyond the median coverage, amplitudes fall with its root, which makes the energies equal.
        """
        emphasis = None if self.emphasis is None else self.emphasis.astype(np.float64)
        if self.labels is None:
            return emphasis
        usage = np.bincount(self.labels, impact.coverage)
        typical = float(np.median(usage[usage > 0])) if (usage > 0).any() else 1.0
        even = np.sqrt(typical / np.maximum(usage, typical))[self.labels]
        return even if emphasis is None else emphasis * even


PLAIN = Variant()
"""A plain model."""
