"""`mark3dgs acquire`: a suspect, preserved as found."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from engine.cli.console import Console
from engine.cli.options import Json


def acquire(
    source: Annotated[str, typer.Argument(metavar="URL|FILE", help="Address (http, https), or what you saved.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.warc.gz", help="WARC file (ISO 28500) to write.")],
    save: Annotated[Path | None, typer.Option("--save", help="Write the suspect itself here, too.")] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="An address that takes longer is given up.")] = 300.0,
    max_bytes: Annotated[int, typer.Option("--max-bytes", min=1, help="Largest file to fetch.")] = 2 << 30,
    tsa: Annotated[
        str | None, typer.Option("--tsa", metavar="URL", help="Get a time stamp from this service (RFC 3161).")
    ] = None,
    private: Annotated[
        bool, typer.Option("--private", help="Addresses may be private, loopback and link-local ones.")
    ] = False,
    json: Json = False,
) -> int:
    """Preserve a suspect as found, before it is examined.

    The WARC file has the bytes, the headers, the server's certificates, the
    time and the version of this program. With --tsa a time stamp of it is
    written next to it (OUT.warc.gz.tsr).

    Examples:

      mark3dgs acquire https://models.example/stolen.ply stolen.warc.gz --save stolen.ply
      mark3dgs acquire saved.ply saved.warc.gz --tsa http://timestamp.example.org
    """
    from engine.errors import InputError
    from engine.records.timestamps import stamp
    from engine.usecases.files import check_target, whole_file
    from service.acquisitions.archive import write_warc
    from service.acquisitions.fetching import TOOL, Exchange, fetch
    from service.blobs import digest_of
    from service.clock import now

    console, fetched = Console(json), source.startswith(("http://", "https://"))
    for target in (out, save):
        if target is not None:
            check_target(target)
    if out.exists():
        raise InputError(f"{str(out)!r} exists: evidence is not replaced, give another name")
    with TemporaryDirectory() as folder:
        body, exchanges, at = Path(source), list[Exchange](), now()
        if fetched:
            body = Path(folder) / "body"
            exchanges, _ = asyncio.run(fetch(source, body, max_bytes, seconds, private=private))
        elif not body.is_file():
            raise InputError(f"cannot read {source!r}: give an address (http, https) or a file")
        with whole_file(out) as part:
            write_warc(part, body, exchanges, body.name, at)
        if save is not None:
            with whole_file(save) as part:
                shutil.copyfile(body, part)
        report: dict[str, str | int | None] = {
            "url": source if fetched else None,
            "at": exchanges[-1].at if exchanges else at,
            "tool": TOOL,
        }
        report |= {"bytes": body.stat().st_size, "payload_sha256": digest_of(body), "warc_sha256": digest_of(out)}
    if tsa is not None:
        stamped = stamp(tsa, out.read_bytes())
        if stamped.token is None:
            raise InputError(f"{stamped.failure}; {out} is written without one")
        with whole_file(out.with_name(f"{out.name}.tsr")) as part:
            part.write_bytes(stamped.token)
    console.say(f"{out}: {report['bytes']:,} bytes {'from ' + source if fetched else 'from a file'}")
    console.say(f"  SHA-256 of the suspect {report['payload_sha256']}")
    console.say(f"  SHA-256 of the WARC    {report['warc_sha256']}")
    console.emit(report)
    return 0
