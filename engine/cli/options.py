"""Options that several commands share, so that they read and behave alike."""

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]

Device = Annotated[
    str,
    typer.Option(
        "--device",
        metavar="auto|cpu|cuda",
        help="What fits pruned models and refines; cuda: a GPU (mark3dgs[cuda]); auto: where there is one.",
    ),
]

Key = Annotated[Path, typer.Option("--key", help="Owner key file, from `mark3dgs keygen`.")]

SpzFrame = Annotated[
    str,
    typer.Option("--spz-frame", help="Axes of .spz input: auto, spec (as specified) or ply (as many tools write it)."),
]

From = Annotated[
    str | None,
    typer.Option("--from", metavar="FORMAT", help="Format of the input, as a file's ending: checked, else refused."),
]

Knobs = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KNOB=VALUE", help="Set an option that `mark3dgs config show` lists; repeatable."),
]
