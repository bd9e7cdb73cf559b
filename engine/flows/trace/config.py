"""Tuned constants of tracing, frozen (DESIGN 4.9)."""

from dataclasses import dataclass

__all__ = ["CONFIG", "TraceConfig"]


@dataclass(frozen=True)
class TraceConfig:
    """Which copies are verified by themselves, and what is kept of them."""

    stands_out: float = 2.5  # z of a copy, read as another one, from which it is verified alone: 1 in 160 innocent ones
    most_grains: int = 4  # grain readings kept: copies have few strengths of it, and each takes 24 bytes a chip
    damped: float = 0.75  # share of the owner's layer's strength below which a copy's own was damped by others


CONFIG = TraceConfig()
