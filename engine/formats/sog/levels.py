"""lod-meta.json, the index of a streamed SOG scene: which rows of which chunk show a part of it, level by level.

Format: "The Streamed SOG Format", version 1, of PlayCanvas's user manual; playcanvas/splat-transform reads and writes
it (``read-lod.ts``, ``write-lod.ts``). Level 0 is the finest.
"""

import re
from dataclasses import dataclass
from typing import Any

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.guards import json_object

LOD_META = "lod-meta.json"
MAX_LOD_META_BYTES = 1 << 24
"""A leaf takes some 300 bytes a level: 10,000 leaves of five levels are 15 MB."""

MAX_LEVELS = 64
_PATH = re.compile(r"([A-Za-z0-9_][A-Za-z0-9_.\-]{0,99}/){0,8}meta\.json")


@dataclass(frozen=True)
class Rows:
    """A run of rows of a chunk."""

    file: int
    offset: int
    count: int


@dataclass(frozen=True)
class LodMeta:
    """What the index says. Paths are those of the chunks' meta.json, relative to its own folder."""

    filenames: tuple[str, ...]
    leaves: tuple[dict[int, Rows], ...]  # rows by level
    environment: str | None  # what is always shown, such as a sky

    @property
    def finest(self) -> list[Rows]:
        """The finest rows there are of each leaf."""
        return [leaf[min(leaf)] for leaf in self.leaves]

    @property
    def left_out(self) -> int:
        """Gaussians of coarser levels."""
        return sum(rows.count for leaf in self.leaves for rows in leaf.values()) - sum(r.count for r in self.finest)


def parse_lod_meta(text: bytes, *, file: str) -> LodMeta:
    """Check an index. UnsupportedFormatError for another version than 1 (early ones name none); FormatError if it is no
    JSON, a member is of the wrong kind, an index leads nowhere, or counts do not agree."""

    def fault(message: str, prop: str) -> FormatError:
        return FormatError(message, file=file, element=LOD_META, prop=prop)

    meta = json_object(text, file=file, element=LOD_META)
    if (version := meta.get("version", 1)) != 1:
        message = f"streamed SOG version {version!r:.40}, read is 1"
        raise UnsupportedFormatError(message, file=file, element=LOD_META, prop="version")
    levels, names = meta.get("lodLevels"), meta.get("filenames")
    if type(levels) is not int or not 1 <= levels <= MAX_LEVELS:
        raise fault(f"{levels!r:.40} is no number of levels", "lodLevels")
    if not isinstance(names, list) or not names:
        raise fault("must list the chunks", "filenames")
    environment = meta.get("environment")
    for name in [*names, *([environment] if environment is not None else [])]:
        if not isinstance(name, str) or not _PATH.fullmatch(name):
            raise fault(f"{name!r:.120} is no plain path of a meta.json", "filenames")
    leaves = _leaves(meta.get("tree"), levels, len(names), fault)
    counts = meta.get("counts")
    if counts is not None:
        there = [sum(leaf[level].count for leaf in leaves if level in leaf) for level in range(levels)]
        if counts != there:
            raise fault(f"the tree holds {there} Gaussians, the index says {counts!r:.120}", "counts")
    return LodMeta(tuple(names), tuple(leaves), environment)


def _leaves(tree: Any, levels: int, files: int, fault: Any) -> list[dict[int, Rows]]:
    leaves, waiting = [], [tree]
    while waiting:
        node = waiting.pop()
        children, lods = (node.get("children", []), node.get("lods", {})) if isinstance(node, dict) else (None, None)
        if not isinstance(children, list) or not isinstance(lods, dict):
            raise fault("a node is no object with children or lods", "tree")
        waiting += reversed(children)
        leaf = {}
        for level, rows in lods.items():
            if level not in map(str, range(levels)) or not isinstance(rows, dict):
                raise fault(f"a leaf has rows of level {level!r:.20}, there are {levels}", "tree")
            numbers: list[Any] = [rows.get(key) for key in ("file", "offset", "count")]
            if not all(type(n) is int and 0 <= n < 1 << 40 for n in numbers) or numbers[0] >= files:
                raise fault(f"a leaf has file, offset, count {numbers!r:.60} of {files} files", "tree")
            leaf[int(level)] = Rows(*numbers)
        if leaf:
            leaves.append(leaf)
    if not leaves:
        raise fault("has no leaf with rows", "tree")
    return leaves
