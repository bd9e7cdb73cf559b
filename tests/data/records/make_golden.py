"""Makes the golden record of this format version: python -m tests.data.records.make_golden. Early ones stay as made.

golden_v1_beside.m3dr is the same record as the first version could write it, with an array beside the plan.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from engine.model import GaussianModel
from engine.records.header import FORMAT_VERSION
from engine.records.record import Record
from engine.records.reference import encode_reference
from engine.watermark.keys import OwnerKey

KEY = OwnerKey(bytes(range(32)))
PATHS = {version: Path(__file__).with_name(f"golden_v{version}.m3dr") for version in (1, 2, 3)}
BESIDE = Path(__file__).with_name("golden_v1_beside.m3dr")


def golden_model() -> GaussianModel:
    """40 Gaussians of degree 1 from integer arithmetic alone: the same on every machine, for ever."""
    k = (np.arange(40 * 22, dtype=np.int64) * 7919 % 1009).reshape(40, 22).astype(np.float32) / 1009
    quats = k[:, 6:10] - 0.5
    return GaussianModel(
        k[:, :3] * 8 - 4, k[:, 3:6] * 4 - 6, quats, k[:, 10] * 8 - 4, (k[:, 10:] - 0.5).reshape(40, 4, 3)
    )


def golden_record(version: int = 1) -> Record:
    """A record with something in every part of it."""
    record = Record.make(
        KEY,
        encode_reference(golden_model(), 1 if version < 3 else 2),
        original_digest="ab" * 32,
        plan=(
            {"message": "deadbeef", "codes": [4, 2], "profile": "fast", "psnr_db": 47.5},
            {
                "labels/0": np.arange(40, dtype=np.uint16) % 4,
                "amplitudes": np.linspace(0, 1, 6),
                "empty": np.zeros((0, 3), dtype=np.float32),
            },
        ),
        extra={"strength": 1.25, "nothing": None},
        copy="for a friend",
        registered_at="2025-01-31T12:00:00Z",
        tool_version="0.1.0",
    )
    return replace(record, header=replace(record.header, format_version=version))


if __name__ == "__main__":
    PATHS[FORMAT_VERSION].write_bytes(golden_record(FORMAT_VERSION).to_bytes(KEY))
