"""Between a record's arrays and what the flows work with: layout, chips, message, cameras, landmarks.

What enters the decision (reference, labels, carriers, amplitudes, message, key views, landmarks) goes into the
record's *plan*; the record id, and so the chips, follow from its digest. Only the settings go beside it.

Amplitudes are those embedded: their strength was settled before the chips were drawn. Records of the first version
have no grain, planned amplitudes of unit strength, and beside the plan the strength, which followed from the chips:
it is used to say what a mark would have shown, never to read one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError, MalformedRecordError
from engine.flows.records.admission import admit
from engine.model import Bool, Camera, GaussianModel
from engine.numerics.plain import Json
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.records.attestation import Trust, Witness, read_attestations
from engine.records.record import Plan, Record, RecordHeader, chip_context, make_record_id
from engine.watermark.grain import ATTRIBUTES, Grain
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.messages import Signs, message_hex, message_signs
from engine.watermark.rates import Attested
from engine.watermark.spreading import Spreading, grain_key, spread, spread_grain

FIRST_STRENGTH = 2.4
"""Strength at which records of the first version are read: typical of 47 dB, the same for all of them."""

Arrays = dict[str, npt.NDArray[Any]]

DRAWN = "drawn"
"""Name of the commitment to what whoever attests the registration drew for the plan."""


@dataclass(frozen=True, eq=False)
class OpenedRecord:
    """A record opened with its key, in the terms of the flows."""

    header: RecordHeader
    copy: str  # name of the recipient
    reference: GaussianModel  # the unmarked reference
    layout: Layout  # of the tint, with its amplitudes
    grain: Grain  # amplitudes of the second layer
    strength: float  # factor from these amplitudes to embedded displacements: 1 but in records of the first version
    message: Signs  # (B,)
    spreading: Spreading  # bits and chips of the tint, drawn anew from the key and the digests of what was opened
    grain_key: bytes = field(repr=False)  # the secret from which those of the grain are drawn
    cameras: list[Camera]  # key views
    landmarks: Landmarks | None
    settings: Json  # profile and configuration of the embedding
    # Digests of what verification relies on beside the record, such as a moving original
    commitments: dict[str, str] = field(default_factory=dict)
    kept: Bool | None = None  # (M,) which Gaussians of the committed reference this one still has, where not all
    attested: Attested | None = None  # somebody else's word on when it was registered, checked by whoever opened it

    def spreading_of(self, chips: int) -> Spreading:
        """Bits and chips of evidence on so many chips: of the tint alone, or of both layers."""
        if chips == len(self.spreading.chips):
            return self.spreading
        gaussians = len(self.reference) if self.kept is None else len(self.kept)
        grain = spread_grain(self.grain_key, gaussians, len(self.message))
        if self.kept is not None:
            rows = np.repeat(self.kept, ATTRIBUTES)
            grain = Spreading(grain.bit_of[rows], grain.chips[rows])
        both = self.spreading.then(grain)
        if chips != len(both.chips):
            raise ValueError(f"evidence on {chips} chips, where {len(self.spreading.chips)} or {len(both.chips)} are")
        return both


def plan_of(
    layout: Layout,
    grain: Grain,
    message: Signs,
    cameras: Sequence[Camera],
    landmarks: Landmarks | None,
    commitments: Mapping[str, str] | None = None,
    *,
    antialiased: bool = False,
) -> Plan:
    """What a record commits to before any chip is drawn: JSON values and arrays."""
    plan: Json = {"message": message_hex(message), "codes": list(layout.codes)}
    if grain.there:
        plan["grain"] = asdict(grain)
    if commitments:
        plan["commitments"] = dict(commitments)
    if antialiased:  # how the reference is drawn
        plan["antialiased"] = True
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
    key: OwnerKey, reference_digest: bytes, copy: str, layout: Layout, plan: Plan
) -> tuple[Spreading, bytes]:
    """Bits and chips of one copy, from the owner's key and everything that enters the decision; and its grain's key."""
    record_id = make_record_id(key, reference_digest, copy, *plan)
    context = chip_context(reference_digest, record_id)
    tint = spread(key, context, layout.codes, len(layout.directions[0]), 4 * len(plan[0]["message"]))
    return tint, grain_key(key, context)


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
    reference = replace(record.reference(), antialiased=record.plan.get("antialiased", False))
    version = record.header.format_version
    sizes = reference.sh.shape[:2]
    admit(version, record.copy, record.plan, record.extra, record.plan_arrays, *sizes)
    codes = tuple(int(count) for count in record.plan["codes"])
    arrays = record.plan_arrays
    labels = tuple(np.ascontiguousarray(arrays[f"labels/{s}"], dtype=np.int32) for s in range(len(codes)))
    directions = tuple(np.asarray(arrays[f"directions/{s}"], dtype=np.float64) for s in range(len(codes)))
    layout = Layout(labels, codes, directions, arrays["amplitudes"].astype(np.float64))
    message = message_signs(record.plan["message"])
    context = record.header.chip_context()
    spreading = spread(key, context, codes, len(directions[0]), len(message))
    strength = 1.0
    if version == 1:
        strength = float(record.extra["strength"]) / FIRST_STRENGTH
        layout = replace(layout, amplitudes=FIRST_STRENGTH * layout.amplitudes)
    cameras = [
        Camera(viewmat, K, int(size[0]), int(size[1]))
        for viewmat, K, size in zip(
            arrays["cameras/viewmats"], arrays["cameras/intrinsics"], arrays["cameras/sizes"], strict=True
        )
    ]
    return OpenedRecord(
        record.header,
        record.copy,
        reference,
        layout,
        Grain(**record.plan.get("grain", {})),
        strength,
        message,
        spreading,
        grain_key(key, context),
        cameras,
        landmarks_in(arrays),
        dict(record.extra["settings"]),
        dict(record.plan.get("commitments", {})),
    )


def landmarks_in(arrays: Mapping[str, npt.NDArray[Any]]) -> Landmarks | None:
    """The bank among a plan's arrays, None where it has none."""
    if "landmarks/points" not in arrays:
        return None
    return Landmarks(*(arrays[f"landmarks/{name}"] for name in ("points", "descriptors", "views")))


def open_attested(data: bytes, key: OwnerKey, trust: Trust) -> tuple[OpenedRecord, tuple[str, ...]]:
    """A record, attested by whom the reader trusts, and what is to be said of other attestations.

    Errors are those of `open_record`; a record whose attestations do not count is opened all the same.
    """
    witnesses: tuple[Witness, ...] = ()
    notes: tuple[str, ...] = ()
    if read_attestations(data):
        from engine.records.witnessing import check_attestations  # certificates take a tenth of a second to import

        witnesses, notes = check_attestations(data, trust)
    opened = open_record(data, key)
    return replace(opened, attested=attested_by(opened, witnesses)), notes


def attested_by(opened: OpenedRecord, witnesses: tuple[Witness, ...]) -> Attested | None:
    """The word that counts most: of one who drew a part of the plan, then the earliest."""
    own = opened.commitments.get(DRAWN, "")
    digest = sha256(own.encode()).hexdigest() if own else "nothing was drawn"
    words = [Attested(each.at, each.by, each.drawn_sha256 == digest) for each in witnesses]
    return min(words, key=lambda word: (not word.drawn, word.moment), default=None)
