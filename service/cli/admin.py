"""`mark3dgs apikey`, `audit` and `rotate-signing-key`: for the operator, on the service's own data."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console
from engine.cli.options import Json
from engine.errors import InputError
from service.cli.serve import start

if TYPE_CHECKING:
    from service.core import Service

apikey = typer.Typer(no_args_is_help=True, help="Make, list and revoke API keys of the service.")
audit = typer.Typer(no_args_is_help=True, help="The append-only log of the service.")
Tenant = Annotated[str, typer.Option("--tenant", help="Whose key; tenants never see one another.")]


@apikey.command("create")
def create(
    tenant: Tenant = "default",
    scopes: Annotated[
        str, typer.Option("--scopes", help="Of embed, verify, read, originals, admin, operator; with commas.")
    ] = "embed,verify,read",
    label: Annotated[str, typer.Option("--label", help="For display.")] = "",
    json: Json = False,
) -> int:
    """Make an API key. It is printed once and kept nowhere.

    Examples:

      mark3dgs apikey create --tenant acme --scopes embed,verify,read
    """
    from service.trust.api_keys import issue

    console, service = _opened(json)
    token = issue(service.db, service.master, tenant, [s.strip() for s in scopes.split(",") if s.strip()], label)
    console.say(token)
    console.emit({"api_key": token, "tenant": tenant})
    return 0


@apikey.command("list")
def list_(tenant: Tenant = "default", json: Json = False) -> int:
    """API keys of a tenant, without their secrets."""
    from service.trust.api_keys import list_keys

    console, service = _opened(json)
    keys = list_keys(service.db, tenant)
    if not keys:
        raise InputError(f"there is no tenant {tenant!r}: it has no API key")
    for key in keys:
        state = f"revoked {key.revoked_at[:19]}" if key.revoked_at else "active"
        console.say(f"{key.id}  {','.join(key.scopes):<24} {state:<28} {key.label}")
    console.emit({"tenant": tenant, "api_keys": [asdict(key) for key in keys]})
    return 0


@apikey.command("revoke")
def revoke(
    key_id: Annotated[str, typer.Argument(metavar="ID", help="The middle part of the key.")],
    tenant: Tenant = "default",
    json: Json = False,
) -> int:
    """Revoke an API key permanently."""
    from service.trust.api_keys import revoke as end

    console, service = _opened(json)
    end(service.db, tenant, key_id)
    console.say(f"revoked {key_id}")
    console.emit({"revoked": key_id})
    return 0


def tenant(
    tenant: Annotated[str, typer.Argument(metavar="ID", help="Id of the tenant, as its API keys name it.")],
    name: Annotated[str, typer.Argument(help="Display name: claims and reports give it as the owner.")],
    json: Json = False,
) -> int:
    """Set a tenant's display name.

    Examples:

      mark3dgs tenant acme "Studio Acme, Hamburg"
    """
    from service.trust.api_keys import name_tenant

    console, service = _opened(json)
    name_tenant(service.db, tenant, name)
    console.say(f"{tenant} is called {name}")
    console.emit({"tenant": tenant, "name": name})
    return 0


@audit.command("verify")
def verify(json: Json = False) -> int:
    """Recompute the whole log: its chain, its tree, and every asset and claim it commits to; and hash every file.

    Exit codes: 0 all holds, 3 something was altered, is damaged or missing.
    """
    from service.trust.audit_check import verify_log

    console, service = _opened(json)
    found = verify_log(service.db, service.blobs)
    console.say(found.text())
    console.emit(found.to_json())
    return 0 if found.ok else 3


def rotate_signing_key(json: Json = False) -> int:
    """Sign claims with a new key from now on. Old claims stay valid: the old public key stays published."""
    from service.trust.signing import rotate

    console, service = _opened(json)
    kid = rotate(service.db, service.master)
    console.say(f"claims are now signed by key {kid}")
    console.emit({"kid": kid})
    return 0


def rotate_master_key(
    new_key_file: Annotated[
        Path | None, typer.Option("--new-key-file", help="64 hex digits; needed where MARK3DGS_MASTER_KEY is set.")
    ] = None,
    json: Json = False,
) -> int:
    """Encrypt all secrets anew under another master key. Stop the service first: running workers are detected, API
    processes are not.

    The file master.key is replaced. API keys, marks and claims stay valid. Put
    the new key where your backup of the old one is.
    """
    from service.trust.rotation import rotate_master

    console = Console(json)
    settings, service = start(console)
    count = rotate_master(settings, service.db, service.master, new_key_file)
    console.say(f"{count} secrets are sealed under the new master key; a backup of the old one opens nothing new")
    console.emit({"resealed": count})
    return 0


def _opened(json: bool) -> tuple[Console, Service]:
    console = Console(json)
    return console, start(console)[1]
