"""`mark3dgs config`: the settings an embedding would run with."""

from dataclasses import asdict
from typing import Annotated, Any

import typer

from engine.cli.console import Console
from engine.cli.options import Json, Knobs
from engine.numerics.plain import Json as Values

app = typer.Typer(no_args_is_help=True, help="Show settings.", rich_markup_mode="rich")


@app.callback()
def _group() -> None:
    """Show the settings an embedding would run with."""


@app.command("show")
def show(
    profile: Annotated[
        str | None,
        typer.Option(
            "--profile",
            metavar="P",
            help="fast, balanced, strong, paper, paper-appendix or auto (its start); all if left out.",
        ),
    ] = None,
    knobs: Knobs = None,
    json: Json = False,
) -> int:
    """Print the composed settings of one profile, or of all side by side.

    Example:

      mark3dgs config show --profile fast --set quantize.cells=1024
    """
    console = Console(json)
    from engine.flows.embed.profiles import PROFILES, Auto, compose

    names = [profile] if profile is not None else list(PROFILES)
    composed = {name: compose(name, knobs=knobs or ()) for name in names}
    settings = {name: asdict(c.start if isinstance(c, Auto) else c) for name, c in composed.items()}
    flat = {name: _flatten(values) for name, values in settings.items()}
    knobs = list(flat[names[0]])
    width = max(len(knob) for knob in knobs)
    console.say(f"{'':<{width}}  " + "  ".join(f"{name:>14}" for name in names))
    console.say(
        *(f"{knob:<{width}}  " + "  ".join(f"{_text(flat[name][knob]):>14}" for name in names) for knob in knobs)
    )
    console.emit(settings[profile] if profile is not None else settings)
    return 0


def _flatten(values: Values, prefix: str = "") -> Values:
    flat: Values = {}
    for name, value in values.items():
        flat |= _flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, (list, tuple)):
        return ",".join(_text(entry) for entry in value) or "-"
    return f"{value:g}" if isinstance(value, float) else str(value)
