"""What registration works out about a reference, each part once at first use."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from engine.model import Bool, Float64, GaussianModel
from engine.registration.hypotheses import chance_table
from engine.registration.match_candidates import FeatureIndex
from engine.registration.matching import Deviations, Matcher, floor_deviations
from engine.registration.patches import Looks
from engine.registration.visibility import HARDLY, drawn


@dataclass(frozen=True, eq=False)
class ReferenceIndex:
    """A reference with what registration works out about it; keep it where many suspects of one come."""

    model: GaussianModel
    _features: dict[tuple[int, bool], FeatureIndex] = field(default_factory=dict, repr=False)
    _looks: dict[int, Looks] = field(default_factory=dict, repr=False)

    @cached_property
    def extent(self) -> float:
        """Median distance from the median centre, scene units; 1 for a model without extent."""
        sample = self.model.means[:: max(1, len(self.model) // 20_000)].astype(np.float64)
        if not len(sample):
            return 1.0
        extent = float(np.median(np.linalg.norm(sample - np.median(sample, axis=0), axis=1)))
        return extent if extent > 0 else 1.0

    @cached_property
    def plain(self) -> Bool:
        """(N,) which Gaussians are drawn so plainly that no copy of them goes unseen."""
        return drawn(self.model, HARDLY)

    @cached_property
    def floor(self) -> Deviations:
        """Errors below which nothing is measured."""
        return floor_deviations(self.extent)

    @cached_property
    def matcher(self) -> Matcher:
        """The reference laid out for matches as exact as trade formats leave them."""
        return Matcher(self.model, self.floor)

    @cached_property
    def chance(self) -> Float64:
        """Chance that two random Gaussians lie within each tolerance."""
        return chance_table(self.model.means.astype(np.float64), self.extent, np.random.default_rng(0))

    def features(self, degree: int, *, colors: bool) -> FeatureIndex:
        """Similarity-invariant looks, up to an SH degree, with or without colours."""
        key = (degree, colors)
        if key not in self._features:
            self._features[key] = FeatureIndex(self.model, degree, colors=colors)
        return self._features[key]

    def looks(self, degree: int) -> Looks:
        """What deformations leave alone, up to an SH degree."""
        if degree not in self._looks:
            self._looks[degree] = Looks(self.model, degree)
        return self._looks[degree]
