"""Where on the asset the mark is, and in how many pieces a suspect holds it (DESIGN 4.10).

1. A model is taken apart: what its registration left over is registered again (`registration.pieces`), blind to chips.
2. Each piece is read by itself, against regions that follow from the plan.
3. Each piece's regions are judged (`watermark.regions`) with its tries times the number of pieces counted: the share of
   false ones among all discoveries is at most the sum of the pieces' own, so it is controlled at the same level.

The claim stays what it was: nothing here enters it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.gaussian_evidence import read_gaussians
from engine.flows.verify.search import Suspect, Verification
from engine.model import Bool, Float64, Int32, Int64
from engine.numerics.blas import one_blas_thread
from engine.numerics.plain import Json
from engine.registration.pieces import register_pieces
from engine.registration.registration_search import Registration
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES
from engine.watermark.layers import layered_z
from engine.watermark.model_evidence import Evidence
from engine.watermark.rates import DRAWS
from engine.watermark.regions import Partition, RegionConfig, Regions, State, divide, judge_regions
from engine.watermark.statistics import log10_false_claim_bound


@dataclass(frozen=True, eq=False)
class FoundPiece:
    """One piece of the asset in the suspect; pictures are read as one."""

    registration: Registration | None  # its own; None where it was not found by its Gaussians
    regions: Regions
    seen: Bool  # (N,) Gaussians of the reference on which the piece says something
    z: float  # of the strongest layer of this piece by itself
    log10_false_claim: float  # the bound for it, with all tries, and pieces, counted

    @property
    def states(self) -> Int32:
        """(N,) `State` of each Gaussian of the reference."""
        return np.where(self.seen, self.regions.of_gaussians(), State.UNSEEN).astype(np.int32)

    @cached_property
    def rows(self) -> tuple[Int32, Int32]:
        """Rows of the suspect in this piece, and the reference Gaussian that each is, or is mostly made of."""
        if self.registration is None:
            return np.empty(0, np.int32), np.empty(0, np.int32)
        mixtures = self.registration.mixtures
        order = np.lexsort((-mixtures.shares, mixtures.suspect_rows))
        rows, first = np.unique(mixtures.suspect_rows[order], return_index=True)
        return rows, mixtures.reference_rows[order][first]


@dataclass(frozen=True, eq=False)
class RegionReport:
    """Evidence by region of one verification. For the owner: regions and their z follow from secret cells."""

    pieces: tuple[FoundPiece, ...]  # none where the asset was not found; the largest first, as a rule
    false_discoveries: float  # level q of the discoveries
    gaussians: int  # N of the reference
    suspect_rows: int  # M of the suspect, 0 of pictures
    claimed: bool  # whether the verification found the mark; if not, no region proves it

    @property
    def states(self) -> Int32:
        """(N,) `State` of each Gaussian of the reference: the one that tells most, of all pieces."""
        states = [piece.states for piece in self.pieces]
        return np.max(states, axis=0) if states else np.zeros(self.gaussians, np.int32)

    @property
    def of_suspect(self) -> tuple[Int32, Int32, Int32]:
        """(M,) piece of each row of the suspect, region of that piece, both -1 where it is nothing of the asset, and
        `State` of that region."""
        piece, region = np.full((2, self.suspect_rows), -1, np.int32)
        state = np.full(self.suspect_rows, State.UNSEEN, np.int32)
        for number, found in enumerate(self.pieces):
            rows, reference = found.rows
            piece[rows], region[rows] = number, found.regions.partition.of_gaussians[reference]
            state[rows] = found.regions.state[region[rows]]
        return piece, region, state

    def summary(self) -> Json:
        """How many regions are in which state, and on what share of the asset's Gaussians: nothing that tells a sign or
        where regions end."""
        counts = np.bincount(np.concatenate([[], *(p.regions.state for p in self.pieces)]).astype(int), minlength=4)
        shares = np.bincount(self.states, minlength=len(State)) / max(1, self.gaussians)
        return {
            "false_discovery_rate": self.false_discoveries,
            "pieces": len(self.pieces),
            **{state.name.lower(): int(counts[state]) for state in reversed(State)},
            "share": {state.name.lower(): round(float(shares[state]), 4) for state in reversed(State)},
        }


@one_blas_thread
def locate_mark(
    suspect: Suspect, opened: OpenedRecord, found: Verification, config: RegionConfig | None = None
) -> RegionReport:
    """Pieces and regions of a suspect in which `verify` with the same record `found` what it found."""
    config = config or RegionConfig()
    reading, tint = found.reading, opened.layout.chips
    model = suspect.model
    size = (len(opened.reference), 0 if model is None else len(model))
    if reading is None or not reading.evidence.weights.any():
        return RegionReport((), config.false_discoveries, *size, False)
    said: list[tuple[Registration | None, list[Evidence]]] = []
    registration = reading.registration
    if model is not None and registration is not None and registration.found:
        for piece in register_pieces(opened.reference, model, first=registration):
            own = reading.evidence if piece is registration else read_gaussians(model, opened, piece)
            said.append((piece, [own]))
    else:
        said.append((None, [each for each in (reading.evidence, reading.scattered) if each is not None]))
    leaves = divide(opened.layout, opened.reference.means, config.most)
    tries = found.claim.tries * len(said)
    # Regions are rated against chance alone: that records may have been tried out is for the claim to count
    by_chance = tries // DRAWS if found.claim.rate_basis == "drawn" else tries
    pieces = []
    for registered, evidence in said:
        spreading = opened.spreading_of(len(evidence[0].y))
        signs, evidence = spreading.signs(opened.message), [each.sized(spreading.sizes) for each in evidence]
        z = max(layered_z(each, signs, tint).best for each in evidence)
        held = None if registered is None else _held(registered, len(opened.reference))
        if held is None:
            seen, evidence = _shown(evidence, opened, leaves)
        else:
            label = opened.layout.labels[0]
            seen = (np.bincount(label, held) > 0)[label]
        regions = judge_regions(evidence, signs, leaves, tint, tries=by_chance, found=held, config=config)
        pieces.append(FoundPiece(registered, regions, seen, z, log10_false_claim_bound(z, tries)))
    claimed = found.claim.verdict == "marked"
    return RegionReport(tuple(pieces), config.false_discoveries, *size, claimed)


def _held(piece: Registration, count: int) -> Bool:
    """(count,) which Gaussians of the reference the piece holds, by themselves or in mixtures."""
    held = np.zeros(count, dtype=bool)
    mixtures = piece.mixtures
    held[mixtures.reference_rows[mixtures.explained()[mixtures.suspect_rows]]] = True
    return held


def _shown(said: list[Evidence], opened: OpenedRecord, leaves: Partition) -> tuple[Bool, list[Evidence]]:
    """(N,) Gaussians in leaves that pictures show, and what they say of these alone.

    What lies behind shines through a little everywhere: the leaves that have hardly a share in what pictures can tell
    are left out, by sizes and not by signs.
    """
    tint = opened.layout.chips
    energy = leaves.sums(np.square(said[0].weights * said[0].signal), tint).sum(axis=1)
    order = np.argsort(energy)
    shown = np.ones(leaves.count, dtype=bool)
    shown[order[np.cumsum(energy[order]) <= CONFIG.regions.faint * energy.sum()]] = False
    codes = shown[leaves.of_codes] & (leaves.of_codes >= 0)
    keep = np.zeros(len(said[0].y), dtype=bool)
    keep[: leaves.chips] = np.repeat(codes, leaves.chips // len(codes))
    seen = shown[leaves.of_gaussians]
    if len(keep) > tint:
        keep[tint:] = np.repeat(seen, ATTRIBUTES)
    return seen, [replace(each, weights=np.where(keep, each.weights, 0.0)) for each in said]


def describe(report: RegionReport, opened: OpenedRecord) -> Json:
    """Plain values of every piece and region; places are in the reference's units, numbers rounded to what they tell.

    z is given to a tenth: more digits of a sum over a few dozen chips would tell their signs.
    """
    means = opened.reference.means.astype(np.float64)
    pieces = []
    for number, piece in enumerate(report.pieces):
        placed = piece.registration
        transform = None
        if placed is not None:
            transform = {
                "scale": placed.scale,
                "rotation": placed.R.tolist(),
                "translation": placed.t.tolist(),
                "mirrored": placed.mirrored,
                "deformed": placed.deformed,
            }
        pieces.append(
            {
                "piece": number,
                "transform": transform,
                "asset_share": None if placed is None else placed.derived_fraction,
                "suspect_gaussians": None if placed is None else len(piece.rows[0]),
                "z": round(piece.z, 1),
                "log10_false_claim": round(piece.log10_false_claim, 1),
                "regions": [_described(k, rows, means, piece) for k, rows in _members(piece.regions.partition)],
            }
        )
    return report.summary() | {"claimed": report.claimed, "found": pieces}


def _members(partition: Partition) -> list[tuple[int, Int64]]:
    """Rows of the reference in each region."""
    order = np.argsort(partition.of_gaussians, kind="stable")
    ends = np.cumsum(np.bincount(partition.of_gaussians, minlength=partition.count))[:-1]
    return list(enumerate(np.split(order, ends)))


def _described(number: int, rows: Int64, means: Float64, piece: FoundPiece) -> Json:
    regions = piece.regions
    middle = means[rows].mean(axis=0) if len(rows) else np.zeros(3)
    radius = float(np.quantile(np.linalg.norm(means[rows] - middle, axis=1), CONFIG.regions.wide)) if len(rows) else 0.0
    return {
        "region": number,
        "state": State(int(regions.state[number])).name.lower(),
        "center": [float(f"{x:.6g}") for x in middle],
        "radius": float(f"{radius:.4g}"),
        "gaussians": len(rows),
        "seen": round(float(piece.seen[rows].mean()), 3) if len(rows) else 0.0,
        "z": round(float(regions.z[number]), 1),
        "expected_z": round(float(regions.expected[number]), 1),
        "log10_p": round(float(regions.log10_p[number]), 1),
    }
