"""`mark3dgs credentials`: a model's Content Credentials (C2PA), signed by its publisher."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from engine.cli.console import Console
from engine.cli.options import Json, SpzFrame
from engine.errors import InputError
from engine.usecases.files import check_target, read_bytes, refuse_same, whole_file, write_secret

app = typer.Typer(
    no_args_is_help=True, help="Content Credentials (C2PA) of a marked model; 'mark3dgs inspect' shows them."
)
Certificates = Annotated[
    Path, typer.Option("--certificates", metavar="PEM", help="Certificate chain, the signer's own first.")
]
PrivateKey = Annotated[
    Path, typer.Option("--private-key", metavar="PEM", help="Key of the signer's certificate, without a password.")
]


@app.command("sign")
def sign(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Marked model, as it will be published.")],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="A .sog with the manifest in it; or MODEL's name ending .c2pa.")
    ],
    record: Annotated[Path, typer.Option("--record", help="Record of its mark: the manifest names its id.")],
    certificates: Certificates,
    private_key: PrivateKey,
    spz_frame: SpzFrame = "auto",
    json: Json = False,
) -> int:
    """Sign a manifest that says: this file, marked, with this mark as soft binding.

    A .sog holds the manifest itself, and stays readable everywhere. The standard
    has no place for one in the other formats: theirs is a sidecar file, with the
    same name and the ending .c2pa. Sign last: any change of the file breaks the
    manifest. Nothing of owner key, recipient or original is in it. Whether the
    mark is in the model is not checked: 'mark3dgs verify' does that.

    Examples:

      mark3dgs credentials sign marked.sog published.sog --record my.record \\
        --certificates chain.pem --private-key signer.key
      mark3dgs credentials sign marked.glb marked.c2pa --record my.record \\
        --certificates chain.pem --private-key signer.key
    """
    console = Console(json)
    from engine.credentials.manifest import EMBEDS, SIDECAR
    from engine.credentials.signer import read_signer
    from engine.credentials.signing import sign_into, sign_sidecar
    from engine.formats.model_reading import read_model
    from engine.records.file import read_header

    refuse_same(model, out)
    check_target(out)
    if out.suffix.lower() not in (f".{EMBEDS}", SIDECAR):
        raise InputError(f"{str(out)!r} must end in .{EMBEDS}, or in {SIDECAR} for a sidecar file")
    signer = read_signer(certificates, private_key)
    record_id = read_header(read_bytes(record, "record")).record_id
    with console.progress() as progress:
        progress("read", 0.0)
        loaded = read_model(model, spz_frame=spz_frame)  # who signs knows that it is a model
    kind, unpacked = loaded.format, any(each.code == "unwrapped" for each in loaded.repairs)
    if unpacked or not model.is_file():
        what = "is packed: unpack it" if unpacked else "is a folder: pack it ('mark3dgs convert')"
        raise InputError(f"{str(model)!r} {what} and sign the file")
    inside = kind == EMBEDS
    if inside != (out.suffix.lower() == f".{EMBEDS}"):
        where = (
            f"holds its manifest itself: OUT must end in .{EMBEDS}"
            if inside
            else f"takes a sidecar file: OUT must end in {SIDECAR}"
        )
        raise InputError(f"{str(model)!r} is {kind}, which {where}")
    with whole_file(out) as part:
        if inside:
            made = sign_into(model, part, record_id, signer)
        else:
            made = sign_sidecar(model, kind, record_id, signer)
            part.write_bytes(made.store)
    report = {
        "model": str(model),
        "out": str(out),
        "format": kind,
        "manifest_id": made.id,
        "manifest_bytes": len(made.store),
        "record_id": record_id,
        "bytes_in": model.stat().st_size,
        "bytes_out": out.stat().st_size,
    }
    console.say(f"Signed {model} -> {out}")
    console.say(f"  manifest    {made.id}, {len(made.store):,} bytes")
    console.say(f"  bound to    record {record_id}")
    if not inside and out != model.with_suffix(SIDECAR):
        console.note(f"Other programs look for it at {model.with_suffix(SIDECAR).name}, in the model's folder.")
    console.emit(report)
    return 0


@app.command("trial")
def trial(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the signer in the certificate.")],
    certificates: Certificates,
    private_key: PrivateKey,
    authority: Annotated[
        Path, typer.Option("--authority", metavar="PEM", help="Certificate of the authority that issues the signer's.")
    ],
    days: Annotated[int, typer.Option("--days", metavar="N", help="How long the certificate is valid.")] = 90,
    json: Json = False,
) -> int:
    """Make a self-issued certificate, to try Content Credentials without buying one.

    Writes three files. Such a signer is trusted nowhere else: to others the
    manifest is valid, and its signer is unknown. To be trusted, have an authority
    of the C2PA trust list issue a certificate.

    Examples:

      mark3dgs credentials trial "Studio Acme" --certificates chain.pem \\
        --private-key signer.key --authority authority.pem
    """
    from engine.credentials.signer import make_trial_signer

    console = Console(json)
    targets = (certificates, private_key, authority)
    if len({path.absolute() for path in targets}) < len(targets):
        raise InputError("certificates, private key and authority need different names")
    for path in targets:
        check_target(path, overwrite=False)
    signer, issued = make_trial_signer(name, days)
    for path, content in ((authority, issued), (certificates, signer.chain), (private_key, signer.key)):
        with whole_file(path, overwrite=False) as part:
            write_secret(part, content)
    until = signer.certificate.not_valid_after_utc.isoformat()
    console.say(
        f"{certificates} is valid until {until[:10]}; its key is in {private_key}, its authority in {authority}"
    )
    console.emit({"certificates": str(certificates), "authority": str(authority), "valid_until": until})
    return 0
