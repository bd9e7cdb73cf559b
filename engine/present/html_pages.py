"""Pages for people: one way to set up their templates, in which every name from outside stays text."""

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

__all__ = ["templates"]


def templates(folder: Path, *, keep_trailing_newline: bool = False) -> Environment:
    """The templates of a folder: values are escaped, a value that is not given is an error."""
    return Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=keep_trailing_newline,
    )
