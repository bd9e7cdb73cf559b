"""`mark3dgs openapi`: the API's description, for client generators and for the frozen copy in openapi/."""

import json
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from engine.cli.console import Console


def openapi(
    out: Annotated[Path | None, typer.Option("--out", help="File to write; standard output if left out.")] = None,
) -> int:
    """Write the OpenAPI document of the service's API."""
    from service.app import make_app
    from service.core import Service
    from service.settings import Settings

    with tempfile.TemporaryDirectory() as folder:
        service = Service.open(Settings(data_dir=Path(folder), database_url="", blob_url=""))
        text = json.dumps(make_app(service).openapi(), indent=1, sort_keys=True) + "\n"
        service.close()
    if out is None:
        Console(machine=False).say(text.rstrip("\n"))
    else:
        out.write_text(text)
    return 0
