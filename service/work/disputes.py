"""Task `dispute`: whose mark is in the other's original, of two registered assets?"""

from pathlib import Path

from engine.flows.dispute.dispute import Party, settle
from service.work.candidates import load_candidates
from service.work.inputs import load_model
from service.work.process import Progress, Reply, Request


def settle_dispute(request: Request, folder: Path, progress: Progress) -> Reply:
    """Contract: docs/SERVICE.md."""
    progress("open record", 0.0)
    parties = request["parties"]
    opened = [candidate.open() for candidate in load_candidates({"candidates": parties})]
    models = [load_model(each).model for each in parties]
    a, b = (Party(*each) for each in zip(opened, models, strict=True))
    return {"finding": settle(a, b, progress).to_json(), "files": {}}
