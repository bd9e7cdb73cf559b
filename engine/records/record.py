"""The record: what the owner keeps of one embedding, and all that verification needs.

`header` says how it binds the chips to the asset, `file` how it lies in a file.
"""

import importlib.metadata
import json
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy.typing as npt

from engine.errors import MalformedRecordError
from engine.model import GaussianModel
from engine.records.codec import canonical_json, pack, unpack
from engine.records.file import MEDIA_TYPE, read_header, seal, unseal
from engine.records.header import Arrays, Plan, RecordHeader, chip_context, copy_digest, key_check, make_record_id
from engine.records.reference import decode_reference, reference_digest
from engine.watermark.keys import OwnerKey

__all__ = ["MEDIA_TYPE", "Plan", "Record", "RecordHeader", "chip_context", "make_record_id", "read_header"]


@dataclass(frozen=True, eq=False)
class Record:
    """A record, opened. Make one with `make` or `from_bytes`; arrays are read-only."""

    header: RecordHeader
    copy: str  # name of the copy
    plan: Mapping[str, Any]  # JSON values settled before the chips were drawn (message, number of codes, commitments)
    plan_arrays: Arrays  # arrays settled before the chips were drawn (labels, carriers, amplitudes, cameras, landmarks)
    extra: Mapping[str, Any]  # JSON values that may follow from the mark (strength, settings)
    reference_arrays: Arrays  # the canonical reference, see `engine.records.reference`

    def __post_init__(self) -> None:
        for name in ("plan", "extra"):  # as it will read back: tuples become lists
            value = MappingProxyType(json.loads(canonical_json(dict(getattr(self, name)))))
            object.__setattr__(self, name, value)
        for name in ("plan_arrays", "reference_arrays"):
            arrays = {key: array.view() for key, array in getattr(self, name).items()}
            for array in arrays.values():
                array.flags.writeable = False
            object.__setattr__(self, name, MappingProxyType(arrays))

    @classmethod
    def make(
        cls,
        key: OwnerKey,
        reference_arrays: Arrays,
        *,
        original_digest: str,
        plan: Plan,
        extra: Mapping[str, Any] | None = None,
        copy: str = "",
        registered_at: str = "",
        tool_version: str | None = None,
    ) -> "Record":
        """A record of one embedding; the header follows from the rest.

        MalformedRecordError if a text or digest is not as `RecordHeader` requires; ValueError or TypeError if plan or
        extra is no JSON, or an array is of a type that cannot be recorded.
        """
        digest = reference_digest(reference_arrays)
        record_id = make_record_id(key, digest, copy, *plan)
        header = RecordHeader(
            record_id=record_id.hex(),
            owner=key.fingerprint,
            reference_digest=digest.hex(),
            original_digest=original_digest,
            registered_at=registered_at,
            copy_digest=copy_digest(key, copy),
            tool_version=this_version() if tool_version is None else tool_version,
            key_check=key_check(key, record_id),
        )
        return cls(header, copy, *plan, extra or {}, reference_arrays)

    def reference(self) -> GaussianModel:
        """The unmarked reference, decoded."""
        return decode_reference(self.reference_arrays)

    def to_bytes(self, key: OwnerKey) -> bytes:
        """The record file. The same record gives the same bytes (with one version of zstd).

        WrongKeyError if the key is not the one that made the record; InputError if the record exceeds 2 GiB.
        """
        groups = {"plan": self.plan_arrays, "reference": self.reference_arrays}
        arrays = {f"{group}/{name}": a for group, members in groups.items() for name, a in members.items()}
        body = pack({"copy": self.copy, "plan": dict(self.plan), "extra": dict(self.extra)}, arrays)
        return seal(self.header, body, key)

    @classmethod
    def from_bytes(cls, data: bytes, key: OwnerKey) -> "Record":
        """Open a record file.

        RecordTooNewError if a later version of this program wrote it; WrongKeyError if it is whole, but another key
        made it; MalformedRecordError if it is no record, was damaged, would unpack to more than `MAX_BODY_BYTES`, or
        its reference or plan is not the one its header names.
        """
        header, body = unseal(data, key)
        meta, arrays = unpack(body)
        if set(meta) != {"copy", "plan", "extra"} or not _is_text(meta["copy"]):
            raise MalformedRecordError("the record's body is malformed")
        if not (isinstance(meta["plan"], dict) and isinstance(meta["extra"], dict)):
            raise MalformedRecordError("the record's plan is malformed")
        # Early records could hold further arrays ("extra/"), which nothing has ever read: they are dropped.
        groups: dict[str, dict[str, npt.NDArray[Any]]] = {"plan": {}, "reference": {}, "extra": {}}
        for name, array in arrays.items():
            group, _, rest = name.partition("/")
            if group not in groups:
                raise MalformedRecordError(f"the record holds an unknown array {name!r}")
            groups[group][rest] = array
        # The chips follow from the header's digest and id: recompute both from what is really inside.
        digest = reference_digest(groups["reference"])
        if digest.hex() != header.reference_digest:
            raise MalformedRecordError("the record's reference is not the one its header names")
        if make_record_id(key, digest, meta["copy"], meta["plan"], groups["plan"]).hex() != header.record_id:
            raise MalformedRecordError("the record's plan is not the one its id names")
        if copy_digest(key, meta["copy"]) != header.copy_digest:
            raise MalformedRecordError("the record's copy is not the one its header names")
        return cls(header, meta["copy"], meta["plan"], groups["plan"], meta["extra"], groups["reference"])


def _is_text(value: Any) -> bool:
    """Whether this is text that can be encoded: JSON also holds halves of characters."""
    return isinstance(value, str) and value.encode(errors="replace").decode() == value


def this_version() -> str:
    """Of this program, as the records it makes name it; empty where it is not installed."""
    try:
        return importlib.metadata.version("mark3dgs")
    except importlib.metadata.PackageNotFoundError:  # run from a source tree
        return ""
