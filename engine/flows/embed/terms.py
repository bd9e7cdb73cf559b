"""The options of an embedding, in addition to model, key and recipient."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

from engine.flows.embed.draws import Stamp
from engine.flows.embed.profiles import Settings
from engine.flows.embed.variant import PLAIN, Variant
from engine.model import Camera
from engine.records.record import Record
from engine.watermark.messages import Signs, check_bits


@dataclass(frozen=True, eq=False, kw_only=True)
class MarkTerms:
    """The options of an embedding; InputError where the length of the message is out of range."""

    message: Signs | None = None  # (B,) +-1; derived from the key where not given
    bits: int = 32  # length of a derived message
    config: Settings | None = None  # Auto to have it chosen; default: `EmbedConfig()`, see `profiles.compose`
    # The owner's own cameras; key views are chosen among them. Generated from the model otherwise
    cameras: Sequence[Camera] | None = None
    registered_at: str = ""  # time of registration as the caller knows it; no clock is read here
    # A time-stamping service that draws a part of the plan once all the rest is settled, so that records cannot be
    # tried out without a request to it; not used where `earlier` has what was drawn
    stamp: Stamp | None = None
    # Record of another copy of this model. Where that was made of this model and views, its landmarks are taken
    # instead of made anew: the bytes are equal, and come sooner
    earlier: Record | None = None
    variant: Variant = PLAIN  # what is special about a model that moves, or brings its own codebook

    def __post_init__(self) -> None:
        check_bits(self.length)

    @property
    def length(self) -> int:
        """Bits of the message."""
        return self.bits if self.message is None else len(self.message)


class MarkOptions(TypedDict, total=False):
    """Fields of `MarkTerms` as keyword arguments; what is left out has its default."""

    message: Signs | None
    bits: int
    config: Settings | None
    cameras: Sequence[Camera] | None
    registered_at: str
    stamp: Stamp | None
    earlier: Record | None
    variant: Variant
