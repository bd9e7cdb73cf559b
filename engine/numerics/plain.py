"""Values as JSON's own types."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, ClassVar, cast

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Json = dict[str, Any]
"""A JSON object, as `json.loads` gives it: what is written out, or was read and not yet checked."""


class Report(Mapping[str, Any]):
    """Base of a frozen dataclass of measurements that reads as its JSON object, too: `report.z` and `report["z"]`."""

    inlined: ClassVar[str] = ""
    """Name of the field, a report itself, whose members stand at the top level, before the others."""

    def to_json(self) -> Json:
        """Plain values."""
        found = asdict(cast("DataclassInstance", self))
        if not self.inlined:
            return found
        del found[self.inlined]
        return dict(getattr(self, self.inlined).to_json() | found)

    def __getitem__(self, name: str) -> Any:
        return self.to_json()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.to_json())

    def __len__(self) -> int:
        return len(self.to_json())


def plain(value: Any) -> Any:
    """A value in JSON's own types: arrays as lists, numbers that are not finite as null."""
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if hasattr(value, "tolist"):  # numpy, without importing it
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)
