"""`mark3dgs keygen`: a fresh owner key."""

from pathlib import Path
from typing import Annotated

import typer

from engine.cli.console import Console
from engine.cli.options import Json


def keygen(
    keyfile: Annotated[Path, typer.Argument(metavar="KEYFILE", help="File to make; it must not exist yet.")],
    json: Json = False,
) -> int:
    """Make an owner key: the secret behind every mark and every claim.

    Only you can read the file (mode 0600), and it is never overwritten. Keep a
    backup offline: without the key no mark can be claimed, and a thief who has it
    can claim and remove yours. One key serves any number of models.

    Example:

      mark3dgs keygen owner.key
    """
    from engine.watermark.keys import OwnerKey

    console = Console(json)
    key = OwnerKey.generate()
    key.write(keyfile)
    console.say(f"Owner key {key.fingerprint} written to {keyfile}. Keep it secret, and keep a backup.")
    console.emit({"keyfile": str(keyfile), "fingerprint": key.fingerprint})
    return 0
