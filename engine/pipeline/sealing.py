"""Between a record's arrays and what the flows work with: layout, chips, message, cameras, landmarks.

What enters the decision (reference, labels, carriers, amplitudes, message, key views, landmarks) goes into the
record's *plan*; the record id, and so the chips, follow from its digest. Only what may follow from the mark (its
strength) and the settings go beside it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError, MalformedRecordError
from engine.model import Camera, GaussianModel
from engine.pictures.landmarks import Landmarks
from engine.pipeline.admission import admit
from engine.records.record import Record, RecordHeader, chip_context, make_record_id
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.messages import Signs, message_hex, message_signs
from engine.watermark.rates import Attested
from engine.watermark.spreading import Spreading, spread

Arrays = dict[str, npt.NDArray[Any]]

DRAWN = "drawn"
"""Name of the commitment to what whoever attests the registration drew for the plan."""


@dataclass(frozen=True, eq=False)
class OpenedRecord:
    """A record opened with its key, in the terms of the flows."""

    header: RecordHeader
    copy: str  # name of the recipient
    reference: GaussianModel  # the unmarked reference
    layout: Layout  # with the planned (relative) amplitudes
    strength: float  # factor from planned amplitudes to embedded displacements
    message: Signs  # (B,)
    spreading: Spreading  # bits and chips, drawn anew from the key and the digests of what was opened
    cameras: list[Camera]  # key views
    landmarks: Landmarks | None
    settings: dict[str, Any]  # profile and configuration of the embedding
    # Digests of what verification relies on beside the record, such as a moving original
    commitments: dict[str, str] = field(default_factory=dict)
    attested: Attested | None = None  # somebody else's word on when it was registered, checked by whoever opened it


def plan_of(
    layout: Layout,
    message: Signs,
    cameras: Sequence[Camera],
    landmarks: Landmarks | None,
    commitments: Mapping[str, str] | None = None,
) -> tuple[dict[str, Any], Arrays]:
    """What a record commits to before any chip is drawn: JSON values and arrays."""
    plan: dict[str, Any] = {"message": message_hex(message), "codes": list(layout.codes)}
    if commitments:
        plan["commitments"] = dict(commitments)
    arrays: Arrays = {"amplitudes": layout.amplitudes.astype(np.float32)}
    for number, (labels, directions) in enumerate(zip(layout.labels, layout.directions, strict=True)):
        arrays[f"labels/{number}"] = labels.astype(np.uint16 if layout.codes[number] <= 65536 else np.int32)
        arrays[f"directions/{number}"] = directions
    arrays["cameras/viewmats"] = np.stack([c.viewmat for c in cameras])
    arrays["cameras/intrinsics"] = np.stack([c.K for c in cameras])
    arrays["cameras/sizes"] = np.array([(c.width, c.height) for c in cameras], dtype=np.int32)
    if landmarks is not None:
        arrays["landmarks/points"] = landmarks.points
        arrays["landmarks/descriptors"] = landmarks.descriptors
        arrays["landmarks/views"] = landmarks.views
    return plan, arrays


def draw_spreading(
    key: OwnerKey, reference_digest: bytes, copy: str, layout: Layout, plan: tuple[dict[str, Any], Arrays]
) -> Spreading:
    """Bits and chips of one copy, from the owner's key and everything that enters the decision."""
    record_id = make_record_id(key, reference_digest, copy, *plan)
    context = chip_context(reference_digest, record_id)
    return spread(key, context, layout.codes, len(layout.directions[0]), 4 * len(plan[0]["message"]))


def open_record(data: bytes, key: OwnerKey, attested: Attested | None = None) -> OpenedRecord:
    """Open a record file and draw its chips again.

    `attested` is somebody else's word on when it was registered, as the caller has checked it. Errors are those of
    `Record.from_bytes`; MalformedRecordError also when the inside does not fit together.
    """
    record = Record.from_bytes(data, key)
    try:
        return replace(_open(record, key), attested=attested)
    except (KeyError, ValueError, IndexError, TypeError, OverflowError, InputError) as error:
        raise MalformedRecordError(f"the record's parts do not fit together: {error}") from error


def _open(record: Record, key: OwnerKey) -> OpenedRecord:
    reference = record.reference()
    admit(record.copy, record.plan, record.extra, record.plan_arrays, len(reference))
    codes = tuple(int(count) for count in record.plan["codes"])
    arrays = record.plan_arrays
    labels = tuple(np.ascontiguousarray(arrays[f"labels/{s}"], dtype=np.int32) for s in range(len(codes)))
    directions = tuple(np.asarray(arrays[f"directions/{s}"], dtype=np.float64) for s in range(len(codes)))
    layout = Layout(labels, codes, directions, arrays["amplitudes"].astype(np.float64))
    message = message_signs(record.plan["message"])
    spreading = spread(key, record.header.chip_context(), codes, len(directions[0]), len(message))
    cameras = [
        Camera(viewmat, K, int(size[0]), int(size[1]))
        for viewmat, K, size in zip(
            arrays["cameras/viewmats"], arrays["cameras/intrinsics"], arrays["cameras/sizes"], strict=True
        )
    ]
    landmarks = None
    if "landmarks/points" in arrays:
        landmarks = Landmarks(arrays["landmarks/points"], arrays["landmarks/descriptors"], arrays["landmarks/views"])
    return OpenedRecord(
        record.header,
        record.copy,
        reference,
        layout,
        float(record.extra["strength"]),
        message,
        spreading,
        cameras,
        landmarks,
        dict(record.extra["settings"]),
        dict(record.plan.get("commitments", {})),
    )
