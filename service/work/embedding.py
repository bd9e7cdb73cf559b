"""Task `embed`: the marked model, the record that proves it, and what people and later searches need."""

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from engine.catalogue.entry import Entry
from engine.errors import Mark3DGSError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import compose, delivered_as
from engine.model import GaussianModel
from engine.records.record import Record
from engine.registration.sketch import make_sketch
from engine.scenes.scene_files import encode_scene, notes_of, output_of, written_as
from engine.scenes.scene_marking import embed_variant
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import check_bits, message_signs
from service.work.inputs import load_cameras, load_model
from service.work.pictures import draw_preview
from service.work.process import Progress


def embed_mark(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    began = time.perf_counter()
    # What is cheap to refuse is refused before the model is read.
    config = compose(
        request["profile"],
        psnr_db=request.get("psnr"),
        output=request.get("output"),
        budget_db=None if request.get("budget") is None else float(request["budget"]),
    )
    key = OwnerKey(bytes.fromhex(request["key"]))
    message = message_signs(request["message"]) if request.get("message") is not None else None
    bits = request.get("bits") or 32
    check_bits(bits)
    cameras = load_cameras(request.get("cameras"))
    progress("read", 0.0)
    loaded = load_model(request)
    kind = request.get("format") or output_of(loaded)
    written_as(loaded, kind)
    read_seconds = time.perf_counter() - began
    request_of_mark: dict[str, Any] = {
        "original_sha256": loaded.sha256,
        "message": message,
        "bits": bits,
        "config": delivered_as(config, kind),
        "cameras": cameras,
        "registered_at": request.get("registered_at") or "",
        "drawn": request.get("drawn") or "",
        "earlier": _earlier(request, key),
        "progress": progress,
    }
    copy, scene = request.get("copy") or "", loaded.scene
    if isinstance(scene, GaussianModel):
        made = embed(scene, key, copy=copy, **request_of_mark)
        scene = made.model
    else:
        scene, made = next(embed_variant(loaded, key, [copy], **request_of_mark))
    started = time.perf_counter()
    progress("write", 0.0)
    files = {"model": f"model.{kind}", "record": "model.record", "preview": "preview.png", "sketch": "entry.bin"}
    record, model = made.record.to_bytes(key), encode_scene(scene, kind)
    (folder / files["record"]).write_bytes(record)
    (folder / files["model"]).write_bytes(model)
    progress("picture", 0.0)
    drawing = time.perf_counter()
    (folder / files["sketch"]).write_bytes(Entry(make_sketch(made.model), made.seen).to_bytes())
    draw_preview(folder / files["preview"], loaded.model, made.model)
    ended = time.perf_counter()
    report = made.report | {
        "format_in": loaded.format,
        "format_out": kind,
        "bytes_in": loaded.source_bytes,
        "bytes_out": len(model),
        "record_bytes": len(record),
        "profile": request["profile"],
        "repairs": [asdict(repair) for repair in loaded.repairs],
        "notes": notes_of(scene, kind),
        "seconds": ended - began,
        "seconds_by_stage": {
            "read": read_seconds,
            **made.report["seconds_by_stage"],
            "write": drawing - started,
            "picture": ended - drawing,
        },
    }
    return {
        "report": report,
        "record_id": made.report["record_id"],
        "message": made.report["message"],
        "format": kind,
        "original_format": loaded.format,
        "original_sha256": loaded.sha256,
        "files": files,
    }


def _earlier(request: Mapping[str, Any], key: OwnerKey) -> Record | None:
    """The record of another copy of this model, if there is one that can be read: it only saves time."""
    if not request.get("earlier"):
        return None
    try:
        return Record.from_bytes(Path(request["earlier"]).read_bytes(), key)
    except (OSError, Mark3DGSError):
        return None
