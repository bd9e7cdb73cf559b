"""The paper's tables as data (`paper.toml` beside this file)."""

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

__all__ = ["PUBLISHED", "printed"]

PUBLISHED = (
    "Published numbers are the paper's own table: other scenes, other hardware, and image decoders that are "
    "blind; it describes no path from a picture to its own, informed decoder."
)


@cache
def _tables() -> dict[str, Any]:
    return tomllib.loads(files(__package__).joinpath("paper.toml").read_text())


def printed(table: str) -> list[dict[str, Any]]:
    """Rows of one of the paper's tables, each a dict by column; what it does not print is None."""
    found = _tables()[table]
    return [
        {name: None if value == "-" else value for name, value in zip(found["columns"], row, strict=True)}
        for row in found["rows"]
    ]
