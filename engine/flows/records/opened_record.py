"""Between a record's arrays and what the flows work with: layout, chips, message, cameras, landmarks.

What enters the decision (reference, labels, carriers, amplitudes, message, key views, landmarks) goes into the
record's *plan*; the record id, and so the chips, follow from its digest. Only the settings go outside it.

Amplitudes are those embedded: their strength was settled before the chips were drawn. Records of the first version
have no grain, planned amplitudes of unit strength, and outside the plan the strength, which followed from the chips:
it is used to say what a mark would have shown, never to read one.

From format 3 on a mark has two layers by purpose. The chips of the *owner's* follow from key, reference and a plan that
all copies share, so no difference of copies shows them; the *copy's* follow from the record id, as all chips did
before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError, MalformedRecordError
from engine.flows.records.admission import admit
from engine.flows.records.draw import DRAWN, Draw, shared_values, stamps_in, terms_of
from engine.model import Bool, Camera, Float32, Float64, GaussianModel, Int32
from engine.numerics.plain import Json
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.records.attestation import Trust, Witness, read_attestations
from engine.records.record import Plan, Record, RecordHeader, chip_context, make_record_id
from engine.watermark.copy_layer import CopyLayer
from engine.watermark.grain import ATTRIBUTES, Grain
from engine.watermark.keys import COPY, LATTICE, OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.messages import Signs, message_hex, message_signs
from engine.watermark.rates import Attested
from engine.watermark.secret_cells import MULTIPLE
from engine.watermark.spreading import Spreading, grain_key, spread, spread_grain

if TYPE_CHECKING:
    from cryptography import x509

ORIGIN = "origin"
"""Of the settings, where the model's centers are doubles far from zero: see `GaussianModel.origin`."""

FIRST_STRENGTH = 2.4
"""Strength at which records of the first version are read: typical of 47 dB, one for all of them."""

Arrays = dict[str, npt.NDArray[Any]]


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
    # Digests of what verification relies on in addition to the record, such as a moving original
    commitments: dict[str, str] = field(default_factory=dict)
    # How this copy differs from others of the asset, and the secret from which its chips are drawn; None where there is
    # no such layer: of a model marked without a recipient, and before format 3, when each copy had a mark of its own
    copies: CopyLayer | None = None
    copy_key: bytes = field(default=b"", repr=False)
    kept: Bool | None = None  # (M,) which Gaussians of the committed reference this one still has, where not all
    draw: Draw | None = None  # by which a part of the plan was drawn, not yet believed; None where none was
    attested: Attested | None = None  # others' word on when it was registered, checked by the caller

    @property
    def origin(self) -> Float64 | None:
        """(3,) what was taken from the centers of a model in map coordinates, and is not in the reference."""
        found = self.settings.get(ORIGIN)
        sound = isinstance(found, list) and len(found) == 3 and all(type(x) is float and abs(x) < 1e12 for x in found)
        return np.array(found) if sound else None

    def spreading_of(self, chips: int) -> Spreading:
        """Bits and chips of evidence on so many chips: of the tint alone, or of both layers."""
        if chips == len(self.spreading.chips):
            return self.spreading
        sized = self.spreading.sizes is not None
        grain = spread_grain(self.grain_key, self._committed, len(self.message), sized=sized)
        if self.kept is not None:
            grain = grain.of(np.repeat(self.kept, ATTRIBUTES))
        both = self.spreading.then(grain)
        if chips != len(both.chips):
            raise ValueError(f"evidence on {chips} chips, where {len(self.spreading.chips)} or {len(both.chips)} are")
        return both

    @property
    def _committed(self) -> int:
        """Gaussians of the reference that the record committed to."""
        return len(self.reference) if self.kept is None else len(self.kept)

    def copy_spreading(self) -> Spreading:
        """The chips of the copy layer. ValueError where there is none."""
        if self.copies is None:
            raise ValueError("this record has no copy layer")
        return self.copies.spreading(self.copy_key, self.kept, self._committed)


@dataclass(frozen=True, eq=False)
class Layers:
    """A settled mark, before its chips."""

    layout: Layout  # of the owner's tint
    grain: Grain  # the owner's
    copies: CopyLayer | None = None
    draw: int = 0  # which of a copy's draws it is: all that copies of an asset differ in here


def plan_of(
    layers: Layers,
    message: Signs,
    cameras: Sequence[Camera],
    landmarks: Landmarks | None,
    commitments: Mapping[str, str] | None = None,
    *,
    antialiased: bool = False,
) -> Plan:
    """What a record commits to before any chip is drawn: JSON values and arrays."""
    layout, grain, copies = layers.layout, layers.grain, layers.copies
    plan: Json = {"message": message_hex(message), "codes": list(layout.codes)}
    if grain.there:
        plan["grain"] = asdict(grain)
    if copies is not None:
        own = {"grain": asdict(copies.grain)} if copies.grain.there else {}
        plan["copies"] = {"codes": copies.layout.codes[0], "draw": layers.draw, **own}
    if commitments:
        plan["commitments"] = dict(commitments)
    if antialiased:  # how the reference is drawn
        plan["antialiased"] = True
    arrays: Arrays = {"amplitudes": layout.amplitudes.astype(np.float32)}
    for number, (labels, directions) in enumerate(zip(layout.labels, layout.directions, strict=True)):
        arrays[f"labels/{number}"] = _kept_labels(labels, layout.codes[number])
        arrays[f"directions/{number}"] = directions
    if layout.multiples is not None:
        arrays["multiples"] = _kept_multiples(layout.multiples)
    if copies is not None:
        arrays["copies/labels"] = _kept_labels(copies.layout.labels[0], copies.layout.codes[0])
        arrays["copies/amplitudes"] = copies.layout.amplitudes.astype(np.float32)
        if copies.layout.multiples is not None:
            arrays["copies/multiples"] = _kept_multiples(copies.layout.multiples)
    arrays["cameras/viewmats"] = np.stack([c.viewmat for c in cameras])
    arrays["cameras/intrinsics"] = np.stack([c.K for c in cameras])
    arrays["cameras/sizes"] = np.array([(c.width, c.height) for c in cameras], dtype=np.int32)
    if landmarks is not None:
        arrays["landmarks/points"] = landmarks.points
        arrays["landmarks/descriptors"] = landmarks.descriptors
        arrays["landmarks/views"] = landmarks.views
    return plan, arrays


def _kept_labels(labels: Int32, codes: int) -> npt.NDArray[Any]:
    return labels.astype(np.uint16 if codes <= 65536 else np.int32)


def _kept_multiples(multiples: Float32) -> npt.NDArray[np.uint8]:
    return np.round(multiples / MULTIPLE).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Drawn:
    """The secrets of one copy, drawn from the owner's key and everything that enters the decision."""

    tint: Spreading  # bits and chips of the owner's tint
    grain_key: bytes = field(repr=False)  # of the owner's grain
    copy_key: bytes = field(repr=False)  # of the copy layer
    lattice_key: bytes = field(default=b"", repr=False)  # of the dither with which marked values are rounded


def draw_owner(key: OwnerKey, reference_digest: bytes, layout: Layout, plan: Plan) -> Drawn:
    """What all copies with this plan have in common; `draw_copy` draws the rest."""
    shared = shared_values(plan[0])
    asset_id = make_record_id(key, reference_digest, "", shared, plan[1])
    context = chip_context(reference_digest, asset_id)
    bits = 4 * len(shared["message"])
    tint = spread(key, context, layout.codes, len(layout.directions[0]), bits, sized=True)
    return Drawn(tint, grain_key(key, context), b"", key.derive(LATTICE, context))


def draw_copy(key: OwnerKey, reference_digest: bytes, copy: str, plan: Plan) -> bytes:
    """The sub-key of one copy's layer."""
    return key.derive(COPY, chip_context(reference_digest, make_record_id(key, reference_digest, copy, *plan)))


def open_record(data: bytes, key: OwnerKey, attested: Attested | None = None) -> OpenedRecord:
    """Open a record file and draw its chips again.

    `attested` is others' word on when it was registered, as the caller has checked it. Errors are those of
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
    strength, copies = 1.0, None
    if version < 3:
        spreading = spread(key, context, codes, len(directions[0]), len(message))
        drawn = Drawn(spreading, grain_key(key, context), b"")
    else:
        if "multiples" in arrays:
            layout = replace(layout, multiples=arrays["multiples"] * MULTIPLE)
        parts = dict(record.plan), dict(arrays)
        drawn = draw_owner(key, bytes.fromhex(record.header.reference_digest), layout, parts)
        if "copies" in record.plan:
            copies = _copy_layer(record.plan["copies"], arrays, directions[0])
            drawn = replace(drawn, copy_key=key.derive(COPY, context))
    if version == 1:
        strength = float(record.extra["strength"]) / FIRST_STRENGTH
        layout = replace(layout, amplitudes=FIRST_STRENGTH * layout.amplitudes)
    stamps, draw = stamps_in(record), None
    if stamps:
        terms = terms_of(key, bytes.fromhex(record.header.reference_digest), (dict(record.plan), dict(arrays)))
        draw = Draw(stamps[-1], record.header.original_digest, terms.hex())
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
        drawn.tint,
        drawn.grain_key,
        cameras,
        landmarks_in(arrays),
        dict(record.extra["settings"]),
        dict(record.plan.get("commitments", {})),
        copies,
        drawn.copy_key,
        draw=draw,
    )


def _copy_layer(plan: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]], directions: Float64) -> CopyLayer:
    labels = np.ascontiguousarray(arrays["copies/labels"], dtype=np.int32)
    multiples = arrays["copies/multiples"] * MULTIPLE if "copies/multiples" in arrays else None
    amplitudes = arrays["copies/amplitudes"].astype(np.float64)
    layout = Layout((labels,), (int(plan["codes"]),), (directions,), amplitudes, multiples)
    return CopyLayer(layout, Grain(**plan.get("grain", {})))


def landmarks_in(arrays: Mapping[str, npt.NDArray[Any]]) -> Landmarks | None:
    """The bank among a plan's arrays, None where it has none."""
    if "landmarks/points" not in arrays:
        return None
    return Landmarks(*(arrays[f"landmarks/{name}"] for name in ("points", "descriptors", "views")))


def open_attested(data: bytes, key: OwnerKey, trust: Trust) -> tuple[OpenedRecord, tuple[str, ...]]:
    """A record, attested by whom the reader trusts, and what is to be said of other attestations.

    Errors are those of `open_record`; a record whose attestations do not count is still opened.
    """
    witnesses: tuple[Witness, ...] = ()
    notes: tuple[str, ...] = ()
    if read_attestations(data):
        from engine.records.witnessing import check_attestations  # certificates take a tenth of a second to import

        witnesses, notes = check_attestations(data, trust)
    opened = open_record(data, key)
    drawer, fault = drawn_by(opened, trust.certificates)
    if drawer is not None:
        witnesses = (*witnesses, drawer)
    return replace(opened, attested=earliest(witnesses, drawn=drawer is not None)), (*notes, *fault)


def drawn_by(opened: OpenedRecord, certificates: Sequence[x509.Certificate]) -> tuple[Witness | None, tuple[str, ...]]:
    """The time-stamping service that drew a part of the plan, if these certificates vouch for it; else what is to be
    said of that, if anything."""
    if opened.draw is None:
        return None, ()
    from engine.records.timestamps import TimestampFault

    try:
        return opened.draw.check(opened.commitments.get(DRAWN, ""), certificates), ()
    except TimestampFault as fault:
        return None, (f"a time stamp is there that drew for the watermark, and does not count: {fault}",)


def earliest(witnesses: Sequence[Witness], *, drawn: bool = False) -> Attested | None:
    """The word that counts: the earliest; whether a part of the plan was `drawn` is known apart."""
    words = [Attested(each.at, each.by, drawn) for each in witnesses]
    return min(words, key=lambda word: word.moment, default=None)


def owner_displacements(opened: OpenedRecord) -> tuple[Float32, Float64 | None]:
    """(N, D) what the layer that carries the claim displaces colours by, and (6 N,) centres and sizes, in their
    units."""
    layout, grain, chips = opened.layout, opened.grain, opened.layout.chips
    values = opened.spreading_of(chips + grain.chips(len(opened.reference))).values(opened.message)
    tint = layout.displace(opened.strength * layout.amplitudes * values[:chips])
    return tint, grain.displacements(values[chips:]) if grain.there else None
