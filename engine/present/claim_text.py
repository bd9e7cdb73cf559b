"""A claim as lines of a terminal; what they say is in `engine.present.wording`."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from engine.present.wording import Words

WIDTH = 96
_LABEL = 16
PARTS = ("says", "does_not_say", "method", "record_time")


def claim_lines(words: Words, *, headline: bool = True, parts: Sequence[str] = PARTS) -> list[str]:
    """A claim as lines of at most WIDTH characters; `parts` of its meaning end it."""
    lines = [*textwrap.wrap(f"{words.headline}. {words.finding}" if headline else words.finding, WIDTH), ""]
    for fact in words.facts:
        lines += textwrap.wrap(
            fact.text, WIDTH, initial_indent=f"  {fact.label:<{_LABEL}}", subsequent_indent=" " * (_LABEL + 2)
        )
    for part in parts:
        lines += ["", *textwrap.wrap(words.meaning[part], WIDTH)]
    return lines
