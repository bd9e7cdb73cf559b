"""Replies of the task `verify` from made-up evidence, judged by the engine itself."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import Any

import numpy as np
from cryptography.x509 import load_pem_x509_certificates
from PIL import Image

from engine.records.timestamps import drawn_from
from engine.watermark.claim import Circumstances, ClaimConfig, Derivation, decide
from engine.watermark.messages import message_hex
from engine.watermark.model_evidence import Evidence
from engine.watermark.rates import Attested, applicable_rate
from engine.watermark.spreading import Spreading
from service.db.schema import assets
from service.jobs.port import Job, State
from tests.data.draws.make_stamp import AUTHORITY, STAMP, TERMS

REGIONS = {
    "false_discovery_rate": 0.01,
    "pieces": 1,
    **{"marked": 41, "altered": 2, "unclear": 3, "unseen": 4},
    "share": {"marked": 0.8, "altered": 0.1, "unclear": 0.05, "unseen": 0.05},
}
KINDS = ("marked", "not_marked", "inconclusive")
CHIPS = 8192
ATTESTED = Attested("2026-11-03T09:14:07.123456+00:00", "the log of this service", drawn=True)
TOKEN = STAMP.read_bytes()
DRAWN = drawn_from(TOKEN)
DRAWING = {"token": base64.b64encode(TOKEN).decode(), "terms": TERMS}
VOUCHING = load_pem_x509_certificates(AUTHORITY.read_bytes())


def reply(
    kind: str = "marked",
    bits: int = 32,
    *,
    strength: float = 1.0,
    attested: Attested | None = ATTESTED,
    seen: str = "",
    **changes: Any,
) -> dict[str, Any]:
    """A reply about the asset "as_1": of a mark of this strength, whose record is attested so, and of a suspect that is
    known since `seen`."""
    random = np.random.default_rng(7)
    bit_of = np.arange(CHIPS) % bits
    chips, message = (random.integers(0, 2, size, dtype=np.int8) * 2 - 1 for size in (CHIPS, bits))
    noise = 0.1 if kind == "not_marked" else 1.0
    y = noise * random.normal(size=CHIPS) + (strength * chips * message[bit_of] if kind == "marked" else 0.0)
    signal = np.full(CHIPS, 1e-3 if kind == "inconclusive" else 1.0)
    pictures = kind == "inconclusive"
    claim = decide(
        Evidence(y, np.ones(CHIPS), signal),
        Spreading(bit_of, chips),
        message,
        Circumstances(
            tries=3,
            route="image" if pictures else "model",
            copy="Studio Nord",
            derivation=Derivation(True, views=(1, 2)) if pictures else Derivation(True, 0.75, 925, 0.01),
            notes=("picture 1: no view of this asset was recognised",) if pictures else (),
        ),
        ClaimConfig.at(applicable_rate(1e-9, attested, seen)),
    )
    assert claim.verdict == kind or strength != 1.0
    return {
        "subject": {"format": "pictures", "gaussians": None, "pictures": 2}
        if pictures
        else {"format": "ply", "gaussians": 1234, "pictures": 0},
        "tries": claim.tries,
        "searched": {"scope": "one", "assets": 1, "compared": 1, "unreadable": 0, "recognised": True},
        "tried": [{"asset": "as_1", "verdict": claim.verdict.value}],
        "asset": "as_1",
        "claim": claim.to_json(),
        "attested": attested.to_json() if attested is not None else None,
        "drawing": DRAWING if attested is not None and attested.drawn else None,
        "registered_message": message_hex(message),
        "checks": [
            {"code": "record_intact", "ok": True, "text": "The record is whole and unaltered."},
            {
                "code": "mark",
                "ok": {"marked": True, "not_marked": False}.get(claim.verdict.value),
                "text": "About the mark.",
            },
        ],
        "regions": REGIONS,
    } | changes


def verify_job(job: str = "job_1", tenant: str = "acme", suspect: str = "12" * 32, **request: Any) -> Job:
    """A job whose suspect is one model."""
    return Job(job, tenant, "", "verify", State.RUNNING, {"model": suspect, **request})


def nothing() -> dict[str, Any]:
    """A reply where no record could be compared."""
    check = {"code": "record_intact", "ok": False, "text": "The record cannot be used."}
    unknown = dict.fromkeys(("asset", "claim", "attested", "drawing", "registered_message", "regions"))
    searched = {"scope": "all", "assets": 2, "compared": 0, "unreadable": 0, "recognised": False}
    return reply() | unknown | {"tries": 0, "checks": [check], "searched": searched}


def asset_row(**changes: Any) -> dict[str, Any]:
    """A whole row of the table `assets`."""
    row: dict[str, Any] = {column.name: column.name for column in assets.columns}
    return row | {
        "id": "as_1",
        "tenant": "acme",
        "copy": "Studio Nord",
        "gaussians": 1234,
        "original_sha256": "ab" * 32,
        "original_format": "ply",
        "record_id": "cd" * 16,
        "record_sha256": "ef" * 32,
        "registered_at": "2026-11-03T09:14:07.123456+00:00",
        **changes,
    }


def picture(shade: int) -> bytes:
    """A small PNG."""
    file = io.BytesIO()
    Image.new("RGB", (8, 6), (shade, shade, shade)).save(file, "PNG")
    return file.getvalue()


PICTURES = {name: picture(shade) for shade, name in enumerate(("asset", "difference", "heatmap", "suspect"))}


def edit(*path: str | int, to: Any) -> Callable[[dict[str, Any]], None]:
    """A change of a document: another value at a place."""

    def change(document: dict[str, Any]) -> None:
        place: Any = document
        for step in path[:-1]:
            place = place[step]
        place[path[-1]] = to

    return change
