"""Where things stand in the report's two drawings; the template draws them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

WIDTH = 724
BITS_PER_LINE = 32
_LEFT, _CELL = 84, 20
_AXIS_LEFT, _AXIS_RIGHT, _AXIS_POWERS = 8, 700, 60


@dataclass(frozen=True)
class Bit:
    """One bit: its place on the line, both values, whether they agree, and 0 (a coin) to 1 (certain)."""

    number: int
    x: int
    registered: int
    read: int
    sure: float

    @property
    def agrees(self) -> bool:
        """Whether the bit was read as registered."""
        return self.registered == self.read


def bit_lines(message: Mapping[str, Any]) -> list[list[Bit]]:
    """The bits of a claim's message, most significant first, in lines."""
    registered, read = (_bits(message[name], message["bits"]) for name in ("registered", "hex"))
    bits = [
        Bit(k, _LEFT + _CELL * (k % BITS_PER_LINE), registered[k], read[k], max(0.0, 2.0 * sure - 1.0))
        for k, sure in enumerate(message["reliability"])
    ]
    return [bits[k : k + BITS_PER_LINE] for k in range(0, len(bits), BITS_PER_LINE)]


@dataclass(frozen=True)
class Scale:
    """The false-claim bound on a logarithmic axis: places in x."""

    left: float
    right: float
    ticks: list[tuple[float, int]]  # and powers of ten
    bar: float  # where the bound stands, or the right end if it lies beyond
    beyond: bool
    limits: list[tuple[float, str]]  # what it is held against


def bound_scale(log10_bound: float, limits: Sequence[tuple[float, str]]) -> Scale:
    """Places on the axis from 1 (left) down to 10^-60 (right)."""
    return Scale(
        _AXIS_LEFT,
        _AXIS_RIGHT,
        [(_place(power), power) for power in range(0, _AXIS_POWERS + 1, 10)],
        _place(-log10_bound),
        -log10_bound > _AXIS_POWERS,
        [(_place(-log10), text) for log10, text in limits],
    )


def _place(powers: float) -> float:
    return round(_AXIS_LEFT + (_AXIS_RIGHT - _AXIS_LEFT) * min(powers / _AXIS_POWERS, 1.0), 1)


def _bits(text: str, count: int) -> list[int]:
    number = bin(int(text, 16))[2:].zfill(4 * len(text)) if text else ""
    return [int(digit) for digit in number[:count]]
