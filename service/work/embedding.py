"""Task `embed`: the marked model, the record that proves it, and what people and later searches need."""

import base64
import time
from pathlib import Path

from engine.catalogue.entry import Entry
from engine.errors import Mark3DGSError
from engine.flows.embed.profiles import compose
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.draw import DRAWN
from engine.records.record import Record
from engine.registration.sketch import make_sketch
from engine.scenes.scene_files import output_of
from engine.usecases.mark import MarkOutput, MarkRequest, mark
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import message_signs
from service.work.inputs import check_model, load_cameras
from service.work.pictures import draw_preview
from service.work.process import Parent, Reply, Request, name_of


def embed_mark(request: Request, folder: Path, progress: Parent) -> Reply:
    """Contract: docs/SERVICE.md."""

    def stamp(data: bytes) -> bytes:
        return base64.b64decode(progress.ask(data.hex()))

    key = OwnerKey(bytes.fromhex(request["key"]))
    files = {"model": "model", "record": "model.record", "preview": "preview.png", "sketch": "entry.bin"}
    # What is cheap to refuse is refused before the model is read.
    mark_request = MarkRequest(
        model=Path(request["model"]),
        key=key,
        outputs={request.get("copy") or "": MarkOutput(folder / files["model"], folder / files["record"])},
        terms=MarkTerms(
            config=compose(
                request["profile"],
                psnr_db=request.get("psnr"),
                output=request.get("output"),
                budget_db=None if request.get("budget") is None else float(request["budget"]),
                survive=request.get("survive"),
            ),
            message=message_signs(request["message"]) if request.get("message") is not None else None,
            bits=request.get("bits") or 32,
            cameras=load_cameras(request.get("cameras")),
            registered_at=request.get("registered_at") or "",
            stamp=stamp if request.get("draws") else None,
            earlier=_earlier(request, key),
        ),
        profile=request["profile"],
        format=request.get("format"),
        name=name_of(request),
        spz_frame=request.get("spz_frame") or "auto",
    )
    (made,) = mark(mark_request, progress, check_model)
    marked = made.embedding
    kind = mark_request.format or output_of(made.loaded)  # a clip is a .ply, too
    files["model"] = f"model.{kind}"
    made.output.model.rename(folder / files["model"])
    progress("picture", 0.0)
    drawing = time.perf_counter()
    seen = None if marked.bank is None else marked.bank.seen
    (folder / files["sketch"]).write_bytes(Entry(make_sketch(marked.model), seen).to_bytes())
    draw_preview(folder / files["preview"], made.loaded.model, marked.model)
    picture = time.perf_counter() - drawing
    report = made.report.to_json() | {"format_out": kind}
    report["seconds"] += picture
    report["seconds_by_stage"]["picture"] = picture
    return {
        "report": report,
        "record_id": marked.report.record_id,
        "message": marked.report.message,
        "drawn": dict(marked.record.plan.get("commitments", {})).get(DRAWN, ""),
        "format": kind,
        "original_format": made.loaded.format,
        "original_sha256": made.loaded.sha256,
        "files": files,
    }


def _earlier(request: Request, key: OwnerKey) -> Record | None:
    """The record of another copy of this model, if there is one that can be read."""
    if not request.get("earlier"):
        return None
    try:
        return Record.from_bytes(Path(request["earlier"]).read_bytes(), key)
    except (OSError, Mark3DGSError):
        return None
