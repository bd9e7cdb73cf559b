"""Odd inputs the whole way, from a file: mark, open the record, verify twice; and as suspects of a sound record.

Each either answers the same each time or is refused in words; a `RuntimeWarning` counts as a fault.
"""

import hashlib
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from engine.errors import Mark3DGSError
from engine.evaluate.marked_scene import MarkedScene, bench_key
from engine.evaluate.stability.odd_inputs import ODD
from engine.evaluate.stability.subjects import config_of, subjects
from engine.evaluate.study import Row
from engine.formats import encode_model, read_model
from engine.model import GaussianModel
from engine.pipeline.embedding import embed
from engine.pipeline.sealing import OpenedRecord, open_record
from engine.pipeline.verification import VerifyConfig, verify_model
from engine.sim.attacks import model_attack
from engine.watermark.claim import Claim

__all__ = ["claim_digest", "stress"]

PIECE = 0.2
"""Connected share of the scene that odd inputs are made of."""
BITS = 16


def claim_digest(claim: Claim) -> str:
    """Of everything a claim says, to the last digit."""
    return hashlib.sha256(json.dumps(claim.to_json(), sort_keys=True).encode()).hexdigest()[:16]


def stress(path: str, names: list[str], quick: bool, seed: int) -> list[Row]:
    """One row for each odd input marked, one for each as a suspect, and two for an empty crop and one key view."""
    piece = model_attack("crop").apply(read_model(path).model, PIECE, rng=seed)
    sound = subjects(path, 1, True, seed).trials[0]
    rows = []
    for name in names:
        rows.append(_row("marked", name, partial(_mark_odd, name, piece, seed)))
        rows.append(_row("suspect", name, partial(_suspect_odd, name, sound)))
    if not quick:
        rows.append(_row("marked", "one key view", partial(_mark_and_verify, piece, 1, seed)))
    empty = sound.marked.take(np.zeros(0, dtype=np.int64))
    rows.append(_row("suspect", "empty crop", partial(_verify_twice, empty, sound.opened)))
    return rows


def _row(role: str, name: str, work: Callable[[], Row]) -> Row:
    about = {"what": "stress", "role": role, "input": name}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            return {**about, **work()}
        except Mark3DGSError as refusal:
            return {**about, "outcome": "refused", "words": str(refusal)}
        except Exception as fault:  # a study reports what a program should not do
            return {**about, "outcome": "fault", "words": f"{type(fault).__name__}: {fault}"}


def _filed(model: GaussianModel) -> GaussianModel:
    """What reading a file of it gives: repaired where that is harmless."""
    return read_model(encode_model(model, "ply"), name="odd.ply").model


def _mark_odd(name: str, piece: GaussianModel, seed: int) -> Row:
    return _mark_and_verify(ODD[name](piece), 3, seed)


def _suspect_odd(name: str, sound: MarkedScene) -> Row:
    return _verify_twice(_filed(ODD[name](sound.marked)), sound.opened)


def _mark_and_verify(model: GaussianModel, views: int, seed: int) -> Row:
    key = bench_key(seed)
    result = embed(
        _filed(model), key, original_sha256="00" * 32, bits=BITS, config=replace(config_of(True), views=views)
    )
    opened = open_record(result.record.to_bytes(key), key)
    row = _verify_twice(_filed(result.model), opened)
    unmarked = verify_model(_filed(model), opened, VerifyConfig(route="model")).claim
    row["unmarked_verdict"] = unmarked.verdict.value
    sound = row["verdict"] == "marked" and unmarked.verdict.value != "marked"
    if row["outcome"] == "same" and not sound:
        row |= {"outcome": "fault", "words": f"own mark: {row['verdict']}, without: {row['unmarked_verdict']}"}
    return row


def _verify_twice(suspect: GaussianModel, opened: OpenedRecord) -> Row:
    first, second = (verify_model(suspect, opened, VerifyConfig(route="model")).claim for _ in range(2))
    same = claim_digest(first) == claim_digest(second)
    return {
        "outcome": "same" if same else "fault",
        "words": "" if same else "two claims differ",
        "verdict": first.verdict.value,
        "z": first.z,
        "bits": first.bit_accuracy,
        "derived_fraction": first.derived_fraction,
    }
