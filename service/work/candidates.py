"""Registered assets that a suspect may derive from, and marks that an upload carries already."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from engine.errors import FormatError
from engine.model import GaussianModel
from engine.pipeline.attesting import attested_by
from engine.pipeline.sealing import OpenedRecord, open_record
from engine.pipeline.searching import Suspect, resembling, search
from engine.pipeline.verification import VerifyConfig
from engine.records.attestation import Witness
from engine.registration.sketch import Sketch
from engine.watermark.claim import Verdict
from engine.watermark.keys import OwnerKey
from service.clock import LOG
from service.work.process import Progress


@dataclass(frozen=True, eq=False)
class Candidate:
    """A registered asset."""

    asset: str  # its id, handed back as it came
    record: Path
    key: OwnerKey
    sketch: Sketch | None  # None where the suspect is to be registered to it in any case
    logged: Mapping[str, str]  # what the service's log says of its registration; empty where it was not asked

    def open(self) -> OpenedRecord:
        """See `engine.pipeline.searching.Candidate`. The log of the service that asks attests the registration."""
        opened = open_record(self.record.read_bytes(), self.key)
        witnesses = (Witness(self.logged["at"], LOG, self.logged["drawn_sha256"]),) if self.logged else ()
        return replace(opened, attested=attested_by(opened, witnesses))


def load_candidates(request: Mapping[str, Any]) -> list[Candidate]:
    """The candidates of a request, in its order."""
    sketches: dict[str, Sketch | None] = {"": None}
    found = []
    for plain in request.get("candidates") or ():
        path = str(plain.get("sketch") or "")
        if path not in sketches:
            sketches[path] = _load_sketch(path)
        key = OwnerKey(bytes.fromhex(plain["key"]))
        logged = plain.get("logged") or {}
        found.append(Candidate(str(plain["asset"]), Path(plain["record"]), key, sketches[path], logged))
    return found


def _load_sketch(path: str) -> Sketch | None:
    try:
        return Sketch.from_bytes(Path(path).read_bytes())
    except FormatError:
        return None  # a damaged sketch must not hide an asset


def find_marks(model: GaussianModel, candidates: Sequence[Candidate], limit: int, progress: Progress) -> dict[str, Any]:
    """Marks that a model carries already: `{"alike", "screened", "carries"}`, see docs/SERVICE.md.

    The Gaussians alone are read, not renders: a screening must be quick, and a mark that only renders show is found by
    `verify`. A record that cannot be opened is passed over: its owner learns that when verifying. Of the candidates
    that are alike, at most `limit` are verified, in the order given: those that matter most come first.
    """
    alike = {candidate.asset for candidate, yes in resembling(model, candidates, progress) if yes}
    chosen = [candidate for candidate in candidates if candidate.asset in alike][:limit]
    config = VerifyConfig(route="model")
    found = search(Suspect(model), chosen, config, lambda stage, fraction: progress("screen", fraction))
    carries = [
        {"asset": each.candidate.asset, "log10_false_claim": each.claim.log10_false_claim, "z": each.claim.z}
        for each in found.outcomes
        if each.claim is not None and each.claim.verdict is Verdict.MARKED
    ]
    return {"alike": len(alike), "screened": len(chosen), "carries": carries}
