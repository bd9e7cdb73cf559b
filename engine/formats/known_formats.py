"""All formats of models: those that the modules of `engine.formats.kinds` declare."""

import pkgutil
from importlib import import_module

from engine.errors import UnsupportedFormatError
from engine.formats import kinds
from engine.formats.declaration import Kind

_MODULES = (import_module(f"{kinds.__name__}.{name}") for _, name, _ in pkgutil.iter_modules(kinds.__path__))  # by name
KINDS: tuple[Kind, ...] = tuple(sorted((k for module in _MODULES for k in module.KINDS), key=lambda k: k.guessed))
KIND_BY_NAME = {kind.name: kind for kind in KINDS}
FORMATS = tuple(kind.name for kind in KINDS if kind.write and not kind.load)
"""What is always read and written; also the file name's ending of each."""
READ = tuple(kind.name for kind in KINDS)
"""What is read."""


def kind_of(name: str) -> Kind:
    """The format whose ending a file's name has; InputError where its packages are not installed."""
    writable = {ending: kind for kind in KINDS if kind.write for ending in (kind.name, *kind.endings)}
    for ending in sorted(writable, key=len, reverse=True):  # .compressed.ply before .ply
        if name.lower().endswith("." + ending):
            kind = writable[ending]
            if kind.load:
                kind.load(f"writing .{kind.name}")
            return kind
    endings = ", ".join("." + kind.name for kind in KINDS if kind.write)
    raise UnsupportedFormatError(f"the name ends in none of {endings}", file=name)
