"""Commands that an extra brings: found by entry points, listed with what they need where that is not installed."""

import re
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, requires, version

import typer

from engine.errors import InputError

__all__ = ["EXTRAS", "add_extra_commands", "missing_packages"]

EXTRAS = ("lab", "service")
"""Extras that bring commands; the entry points of each stand in the group `mark3dgs.commands.EXTRA`."""


def add_extra_commands(app: typer.Typer) -> None:
    """Add every extra's commands; those whose packages are missing are listed, and say so when called."""
    for extra in EXTRAS:
        found = entry_points(group=f"mark3dgs.commands.{extra}")
        missing = missing_packages(extra) if found else []
        for entry in sorted(found, key=_position):
            if missing:
                context = {"allow_extra_args": True, "ignore_unknown_options": True}
                app.command(
                    entry.name, help=rf"Needs mark3dgs\[{extra}].", context_settings=context, add_help_option=False
                )(_refusal(entry.name, extra, missing))
                continue
            command = entry.load()
            if isinstance(command, typer.Typer):
                app.add_typer(command, name=entry.name)
            else:
                app.command(entry.name)(command)


def missing_packages(extra: str) -> list[str]:
    """Names of the packages that an extra of this distribution needs and that are not installed."""
    wanted = [text for text in requires("mark3dgs") or () if re.search(rf"extra == ['\"]{extra}['\"]", text)]
    names = [re.split(r"[^\w.-]", text, maxsplit=1)[0] for text in wanted]
    return [name for name in names if not _installed(name)]


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True


def _position(entry: EntryPoint) -> tuple[str, str]:
    return (entry.module, entry.name)


def _refusal(name: str, extra: str, missing: Sequence[str]) -> Callable[[], None]:
    def refuse() -> None:
        raise InputError(
            f"'mark3dgs {name}' needs the extra {extra!r} (missing: {', '.join(missing)}); "
            f"install it with: pip install 'mark3dgs[{extra}]'"
        )

    return refuse
