"""Copies of one asset: placed in a suspect once, and read once for all of them.

They have the reference in common, and so where it lies and what every Gaussian says; from format 3 on the evidence of
their copy layer, too. Before, cells, chips and amplitudes were each copy's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from engine.flows.progress import Clock
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.gaussian_evidence import compare_tint, duplicate_weights, read_grain, read_tint
from engine.flows.verify.search import Reading, Suspect, readings, time_budget
from engine.model import Float32
from engine.watermark.grain import Grain
from engine.watermark.image_evidence import gather_again
from engine.watermark.model_evidence import Evidence, Residual


@dataclass(frozen=True)
class TraceConfig:
    """Which copies are verified by themselves, and what is kept of them."""

    stands_out: float = 2.5  # z of a copy, read as another one, from which it is verified alone: 1 in 160 innocent ones
    most_grains: int = 4  # grain readings kept: copies have few strengths of it, and each takes 24 bytes a chip
    damped: float = 0.75  # share of the owner's layer's strength below which a copy's own was damped by others


CONFIG = TraceConfig()


def asset_of(opened: OpenedRecord) -> tuple[str, bool, bytes]:
    """What the records of copies that are read together have in common: from format 3 on the owner's layer, too."""
    shared = b"" if opened.spreading.sizes is None else opened.grain_key
    return opened.header.reference_digest, opened.grain.there, shared


class Copies:
    """One asset's place in the suspect, found once for all of its copies, along one route after the other."""

    def __init__(
        self, suspect: Suspect, first: OpenedRecord, routes: Sequence[str], config: VerifyConfig, clock: Clock
    ) -> None:
        self.read_as = first.header.record_id
        self._suspect = suspect
        self._readings = enumerate(readings(suspect, first, routes, config.seed, clock, time_budget(suspect, config)))
        self._route = -1
        self._tint = first.layout.chips  # of the copy that it is read as
        self._weights: Float32 | None = None  # of the suspect's Gaussians
        self._compared: dict[int, Residual] = {}  # colours, by the width of the carriers
        self._grain: dict[Grain, Evidence] = {}  # of the Gaussians
        self.reading: Reading

    def go_along(self, route: int) -> None:
        """Have read along this route, by its number; they are taken in turn."""
        if self._route < route:
            self._route, self.reading = next(self._readings)

    def reading_of(self, opened: OpenedRecord) -> Reading:
        """The reading as it speaks of one copy."""
        if opened.spreading.sizes is not None:  # the owner's layer is that of all copies
            return self.reading
        return replace(self.reading, evidence=self.evidence(opened), scattered=None)

    def evidence(self, opened: OpenedRecord) -> Evidence:
        """What the suspect says of the chips of one copy, along all routes so far.

        Of Gaussians that is all that reading this copy alone would say; pictures say nothing of what to expect, and
        the grain counts in them as it does for the copy that they were read as.
        """
        reading = self.reading
        pictures = gather_again(opened.layout, reading.evidence.pulled)
        if reading.pictures is not None:  # copies have other cells, and their Gaussians in common
            pictures = pictures.then(reading.pictures.behind(self._tint))
        if reading.route in ("image", "render"):
            return pictures
        assert self._suspect.model is not None
        assert reading.registration is not None
        if self._weights is None:
            self._weights = duplicate_weights(self._suspect.model, reading.registration.matches)
        read = self._suspect.model, opened, reading.registration, self._weights
        width = opened.layout.width
        if width not in self._compared:
            self._compared = {width: compare_tint(*read)}
        model = read_tint(opened, self._compared[width])
        if opened.grain.there:
            if opened.grain not in self._grain:
                if len(self._grain) == CONFIG.most_grains:
                    self._grain.clear()
                self._grain[opened.grain] = read_grain(*read)
            model = model.then(self._grain[opened.grain])
        return model.plus(pictures) if reading.route == "both" else model
