"""Colluding recipients: who is named, and is an innocent ever named? (`mark3dgs bench collusion`)

Extraction is informed: the suspect is read against the owner's records.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from engine.evaluate.marked_scene import bench_key
from engine.formats import read_model
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import profile
from engine.pipeline.sealing import OpenedRecord, draw_spreading, open_record, plan_of
from engine.pipeline.tracing import trace_model
from engine.pipeline.verification import VerifyConfig
from engine.records.header import make_record_id
from engine.sim.adversaries.collusion import RULES, collude
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import derive_message

__all__ = ["bench_collusion", "innocent_copies"]

COPIES = (2, 3, 5, 10)
BITS = 32


def bench_collusion(
    path: Path,
    *,
    innocents: int = 10_000,
    copies: Sequence[int] = COPIES,
    rules: Sequence[str] = tuple(RULES),
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> list[dict[str, Any]]:
    """Copies of one scene for several buyers, put together by every rule, and traced among innocent buyers.

    Parameters
    ----------
    innocents : int
        Records of copies that took no part.
    copies : sequence of int
        Colluders; one row for each number and rule.
    rules : sequence of str
        See `collude`.
    seed : int
        Of the key and of the rules that draw.
    advance : callable, optional
        Told the fraction done.

    Returns
    -------
    list of dict
        `named` of `colluders`, their smallest z, the largest z of an innocent, `innocents_named`, the bar.
    """
    loaded, key = read_model(path), bench_key(seed)
    config = profile("fast", landmark_views=0)
    models, records = [], []
    for number in range(max(copies)):
        made = embed(loaded.model, key, original_sha256=loaded.sha256, bits=BITS, config=config, copy=f"buyer {number}")
        models.append(made.model)
        records.append(open_record(made.record.to_bytes(key), key))
    bystanders = list(innocent_copies(records[0], key, innocents))
    rows = []
    for count in copies:
        for rule in rules:
            rng = np.random.default_rng((seed, count))
            suspect = collude(models[0], rule, rng, others=models[1:count])
            traced = trace_model(suspect, [*records[:count], *bystanders], VerifyConfig(route="model"))
            guilty = [finding for finding in traced.findings if finding.copy.startswith("buyer ")]
            others = [finding for finding in traced.findings if not finding.copy.startswith("buyer ")]
            rows.append(
                {
                    "scene": path.name,
                    "rule": rule,
                    "colluders": count,
                    "named": sum(finding.named for finding in guilty),
                    "z_least": min(finding.z for finding in guilty),
                    "innocents": len(others),
                    "innocents_named": sum(finding.named for finding in others),
                    "innocent_z_largest": max((finding.z for finding in others), default=0.0),
                    "z_threshold": traced.z_threshold,
                    "seconds": traced.seconds,
                }
            )
            if advance is not None:
                advance(len(rows) / (len(copies) * len(rules)))
    return rows


def innocent_copies(record: OpenedRecord, key: OwnerKey, count: int) -> Iterator[OpenedRecord]:
    """Records of copies of the same asset that no suspect was made of, drawn as an embedding draws them.

    Parameters
    ----------
    record : OpenedRecord
        Of a copy without landmarks, with a message derived from its name.
    key : OwnerKey
        Its key.
    """
    reference = bytes.fromhex(record.header.reference_digest)
    for number in range(count):
        name = f"innocent {number}"
        message = derive_message(key, len(record.message), reference + name.encode())
        plan = plan_of(record.layout, message, record.cameras, None)
        spreading = draw_spreading(key, reference, name, record.layout, plan)
        record_id = make_record_id(key, reference, name, *plan).hex()
        header = replace(record.header, record_id=record_id)
        yield replace(record, header=header, copy=name, message=message, spreading=spreading)
