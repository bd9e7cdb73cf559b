"""`mark3dgs serve` and `mark3dgs worker`: the API and the processes that do the work."""

from __future__ import annotations

import logging
import os
import resource
import select
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console
from engine.cli.options import Json
from engine.errors import InputError
from service.cli import log
from service.problems import Problem

if TYPE_CHECKING:
    from service.core import Service
    from service.settings import Settings

RESTART_SECONDS = 1.0
SPARE_FILES = 256

FIRST_PAUSE_SECONDS, LONGEST_PAUSE_SECONDS = 0.5, 10.0
"""Between two attempts to reach the database server; each pause is twice the one before."""

_log = logging.getLogger(__name__)


def serve(
    host: Annotated[str, typer.Option("--host", help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Port to listen on.")] = 8000,
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=0, help="Worker processes (default 1, or MARK3DGS_WORKERS); 0: API only."),
    ] = None,
) -> int:
    """Run the ownership service: API, page and workers, in one data folder.

    A second one in this folder is refused, unless it starts no workers
    ('--workers 0'). Needs no other server. The first start makes the master
    key, the signing key and one admin API key, which a terminal shows once
    (without one: admin.key). Settings are environment variables:
    MARK3DGS_DATA_DIR (default ./mark3dgs-data), MARK3DGS_DATABASE_URL and
    MARK3DGS_BLOB_URL for several machines, and more (see docs/SERVICE.md).

    Examples:

      mark3dgs serve
      MARK3DGS_DATA_DIR=~/mark3dgs mark3dgs serve --host 0.0.0.0 --port 80
    """
    import uvicorn

    from engine.credentials.native import require
    from service.app import make_app
    from service.assets.content_credentials import signer_of
    from service.folder_locks import crew_names, hold
    from service.trust.draws import vouching

    console = Console(machine=False)
    log.set_up()
    settings = settings_of()
    count = settings.workers if workers is None else workers
    lock = hold(settings.data_dir, "serve") if count else None  # before a database is opened, which changes it
    _check_free(host, port)
    settings, service = start(console, may_make=True, waits=True)
    if (signer := signer_of(settings)) is not None:  # what is wrong with it is said now, not at the first download
        require()
        until = f"{signer.certificate.not_valid_after_utc:%Y-%m-%d}"
        console.note(f"Content Credentials are signed by {signer.certificate.subject.rfc4514_string()}, until {until}.")
    vouching(settings)
    crew = Crew(crew_names(settings.data_dir, count) if count else [])
    console.note(f"Serving on http://{host}:{port} with {count} worker{'s' if count != 1 else ''}. Ctrl-C stops.")
    try:
        crew.start()
        uvicorn.run(
            make_app(service),
            host=host,
            port=port,
            log_level="warning",
            log_config=None,
            access_log=False,
            limit_concurrency=_connections(settings.connections),
            server_header=False,
            http="h11",
            timeout_graceful_shutdown=5,
        )
    finally:
        crew.stop()
        if lock is not None:
            lock.close()
    return 0


def worker(
    name: Annotated[
        str, typer.Option("--name", help="Stable name: a worker restarted under it continues its jobs.")
    ] = "",
    die_with_parent: Annotated[
        bool, typer.Option("--die-with-parent", help="Stop when standard input ends.", hidden=True)
    ] = False,
) -> int:
    """Run jobs of a service that shares its database and blobs.

    Start as many as wanted, on as many machines as wanted, with the same
    MARK3DGS_DATABASE_URL, MARK3DGS_BLOB_URL and MARK3DGS_MASTER_KEY as the API.
    """
    from service.worker import run_worker

    log.set_up()
    _, service = start(Console(machine=False), waits=True, die_with_parent=die_with_parent)
    run_worker(service, name, die_with_parent)


def init(json: Json = False) -> int:
    """Make a service's data folder, its keys and its first API key, and start nothing.

    `serve` does that by itself; every other command needs an existing service.

    Examples:

      MARK3DGS_DATA_DIR=~/mark3dgs mark3dgs init
    """
    console = Console(json)
    settings, service = start(console, may_make=True)
    console.say(f"The service in {settings.data_dir} is ready: 'mark3dgs serve' runs it.")
    console.emit({"data_dir": str(settings.data_dir)})
    service.close()
    return 0


def settings_of() -> Settings:
    """The settings of this process; what it writes is its user's alone. InputError names a wrong variable."""
    from pydantic import ValidationError

    from service.settings import Settings

    os.umask(0o077)
    try:
        return Settings()
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"MARK3DGS_{'_'.join(map(str, first['loc'])).upper()}: {first['msg']}") from None


def start(
    console: Console, *, may_make: bool = False, waits: bool = False, die_with_parent: bool = False
) -> tuple[Settings, Service]:
    """Open the service; the first start makes its keys and prints a note. InputError where there is none to open.

    A database server that does not answer is a TimeoutError, with `waits` after MARK3DGS_DATABASE_WAIT_SECONDS; one
    that refuses these settings is an InputError at once. With `die_with_parent` the wait ends when standard input does.
    """
    from service.db.database import refusal, server_of
    from service.trust.api_keys import FIRST_TENANT

    settings = settings_of()
    patience = settings.database_wait_seconds if waits else 0.0
    until, pause = time.monotonic() + patience, FIRST_PAUSE_SECONDS
    while True:
        try:
            service, token = _open(settings, may_make)
            break
        except Problem as problem:
            if problem.kind != "unavailable" or not settings.database_url:
                raise
            server = f"the database server at {server_of(settings.database_url)}"
            if said := refusal(problem):
                raise InputError(f"{server} refuses MARK3DGS_DATABASE_URL: {said}") from None
            text = f"{server} does not answer: start it, or correct MARK3DGS_DATABASE_URL"
            if time.monotonic() + pause > until:
                raise TimeoutError(f"{text} (waited for {patience:g} s)" if patience else text) from None
            _log.warning("%s; the next attempt follows in %g s", text, pause)
        if select.select([sys.stdin] if die_with_parent else [], [], [], pause)[0]:
            sys.exit()
        pause = min(2 * pause, LONGEST_PAUSE_SECONDS)
    if token is not None:
        console.note("First start: the master key, the signing key and one admin API key were made.")
        if settings.master_key is None:
            console.note(
                f"  master key   {settings.data_dir / 'master.key'}  (seals all other keys: back it up, apart)"
            )
        _hand_over(console, token, settings.data_dir / "admin.key")
        console.note(
            f"  your name    is {FIRST_TENANT!r} in claims: enter it on the page, or mark3dgs tenant {FIRST_TENANT} ..."
        )
        if not settings.public_url:
            console.note("  address      none in claims and links: enter it on the page, or set MARK3DGS_PUBLIC_URL")
    return settings, service


def _open(settings: Settings, may_make: bool) -> tuple[Service, str | None]:
    """The service, and its first API key where this made it."""
    from service.core import Service
    from service.db import Database
    from service.trust.api_keys import FIRST_TENANT, issue_first
    from service.trust.signing import ensure_key

    if not may_make and not Database(settings.database()).exists:
        place = "MARK3DGS_DATABASE_URL" if settings.database_url else str(settings.data_dir)
        raise InputError(f"there is no service in {place}: 'mark3dgs serve' or 'mark3dgs init' makes one")
    service = Service.open(settings)
    ensure_key(service.db, service.master)
    return service, issue_first(service.db, service.master, FIRST_TENANT, "first admin key")


def _hand_over(console: Console, token: str, path: Path) -> None:
    """Show the first API key to a person; what is written to a log is there for long, so it gets a file instead."""
    from service.trust.master import write_key

    if sys.stderr.isatty():
        console.note(f"  API key      {token}")
        console.note("This API key is shown once and kept nowhere: write it down. 'mark3dgs apikey' makes others.")
        return
    write_key(path, token)
    console.note(f"  API key      in {path}: read it, then delete that file. 'mark3dgs apikey' makes others.")


def _check_free(host: str, port: int) -> None:
    """Refuse an address that cannot be listened on, before anything is started."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            text = f"cannot listen on {host}:{port}: {error.strerror or error}; choose another --host or --port"
            raise InputError(text) from None


def _connections(most: int) -> int:
    """How many connections are taken: as many as wanted, or half of the files that this process may open."""
    files, limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files != resource.RLIM_INFINITY and files < 2 * most + SPARE_FILES:
        files = 2 * most + SPARE_FILES if limit == resource.RLIM_INFINITY else min(limit, 2 * most + SPARE_FILES)
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, limit))
    return most if files == resource.RLIM_INFINITY else min(most, files // 2)


class Crew:
    """Worker processes of this machine; one that dies is started again under its name."""

    def __init__(self, names: list[str]) -> None:
        self._names = names
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._stopping = threading.Event()

    def start(self) -> None:
        """Start all, and watch over them."""
        for name in self._names:
            self._launch(name)
        if self._names:
            threading.Thread(target=self._watch, daemon=True).start()

    def stop(self) -> None:
        """End all; a running job continues at the next start."""
        self._stopping.set()
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()

    def _launch(self, name: str) -> None:
        command = [sys.executable, "-m", "service.cli", "worker", "--name", name, "--die-with-parent"]
        # Its standard input is our pipe: it ends when this process does, however that dies.
        self._running[name] = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True, env=os.environ)

    def _watch(self) -> None:
        while not self._stopping.wait(RESTART_SECONDS):
            for name, process in list(self._running.items()):
                if process.poll() is not None and not self._stopping.is_set():
                    sys.stderr.write(f"worker {name} ended with status {process.returncode}; starting it again\n")
                    time.sleep(RESTART_SECONDS)
                    self._launch(name)
