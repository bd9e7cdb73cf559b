"""Registered assets that a suspect may derive from, marks that an upload carries already, and disputes of two."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from cryptography.x509 import load_pem_x509_certificates

from engine.errors import MalformedRecordError
from engine.flows.dispute.dispute import Party, settle
from engine.flows.records.opened_record import OpenedRecord, drawn_by, earliest, open_record
from engine.flows.trace.candidates import search
from engine.flows.verify.search import Suspect, VerifyConfig
from engine.records.attestation import Witness
from engine.watermark.keys import OwnerKey
from service.clock import LOG
from service.work.inputs import load_model
from service.work.process import Progress, Reply, Request


@dataclass(frozen=True, eq=False)
class Candidate:
    """A registered asset."""

    asset: str  # its id, handed back as it came
    original: str  # SHA-256 of the file that was marked
    record: Path
    key: OwnerKey
    logged: Mapping[str, str]  # what the service's log says of its registration; empty where not needed
    vouched: str = ""  # certificates (PEM) that vouch for the time-stamping service that drew for it

    def open(self) -> OpenedRecord:
        """See `engine.flows.verify.search.Candidate`. The calling service's log attests the registration; a
        time-stamping service attests that the chips were not tried out."""
        try:
            data = self.record.read_bytes()
        except OSError:
            raise MalformedRecordError("the record of this asset is gone") from None
        opened = open_record(data, self.key)
        if not self.logged:
            return opened
        certificates = load_pem_x509_certificates(self.vouched.encode()) if self.vouched else ()
        drawer, _ = drawn_by(opened, certificates)
        word = Witness(self.logged["at"], LOG)
        return replace(opened, attested=earliest([word], drawn=drawer is not None))


def load_candidates(request: Request) -> list[Candidate]:
    """The candidates of a request, in its order."""
    found = []
    for plain in request.get("candidates") or ():
        key = OwnerKey(bytes.fromhex(plain["key"]))
        names = str(plain["asset"]), str(plain["original"])
        logged, vouched = plain.get("logged") or {}, plain.get("vouched") or ""
        found.append(Candidate(*names, Path(plain["record"]), key, logged, vouched))
    return found


def find_marks(request: Request, folder: Path, progress: Progress) -> Reply:
    """Task `marks`. Contract: docs/SERVICE.md.

    The Gaussians alone are read, not renders: a screening must be quick, and a mark that only renders show is found by
    `verify`. A record that cannot be opened is passed over: its owner learns that when verifying.
    """
    suspect, config = Suspect(load_model(request).model), VerifyConfig(route="model")
    found = search(suspect, load_candidates(request), config, lambda stage, fraction: progress("screen", fraction))
    names = ("log10_false_claim", "z", "copy_z", "copy_named")
    carries = [
        {"asset": each.candidate.asset} | {name: getattr(each.claim, name) for name in names}
        for each in found.outcomes
        if each.marked
    ]
    return {"carries": carries}


def settle_dispute(request: Request, folder: Path, progress: Progress) -> Reply:
    """Task `dispute`: whose mark is in the other's original, of two registered assets? Contract: docs/SERVICE.md."""
    progress("open record", 0.0)
    parties = request["parties"]
    opened = [candidate.open() for candidate in load_candidates({"candidates": parties})]
    models = [load_model(each).model for each in parties]
    a, b = (Party(*each) for each in zip(opened, models, strict=True))
    return {"finding": settle(a, b, progress).to_json(), "files": {}}
