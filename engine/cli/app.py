"""The command `mark3dgs`: its sub-commands, and the one place where errors become exit codes."""

import gc
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from typing import Annotated

import typer

from engine.cli import (
    attest,
    config,
    convert,
    credentials,
    dispute,
    embed,
    failures,
    inspect,
    keygen,
    render,
    trace,
    verify,
)
from engine.cli.console import DATA_ON_STDOUT, Console
from engine.errors import InputError
from engine.kernels.allocation import keep_freed_memory

app = typer.Typer(
    name="mark3dgs",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mark3dgs {version('mark3dgs')}")
        raise typer.Exit()


@app.callback()
def _top(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Hide an ownership mark in a 3D Gaussian Splatting model; prove it later.

    The whole job, from a key to a claim:

      mark3dgs keygen owner.key
      mark3dgs embed scene.ply marked.ply --key owner.key --record scene.record
      mark3dgs verify suspect.ply --key owner.key --record scene.record

    Exit codes: 0 done, or marked; 3 the unmarked original; 4 inconclusive; 2 wrong usage or
    input; 1 a fault of the program or the machine; 130 interrupted.

    Every command takes --json and explains itself with --help.
    """


app.command("keygen")(keygen.keygen)
app.command("inspect")(inspect.inspect)
app.command("convert")(convert.convert)
app.command("embed")(embed.embed)
app.command("verify")(verify.verify)
app.command("trace")(trace.trace)
app.command("attest")(attest.attest)
app.command("dispute")(dispute.dispute)
app.command("render")(render.render)
app.add_typer(config.app, name="config")
app.add_typer(credentials.app, name="credentials")

CORE = frozenset({str(command.name) for command in app.registered_commands} | {"config", "credentials"})
"""Commands that need no extra."""


def run(arguments: list[str]) -> int:
    """Exit code of one command line (without the program's name).

    Every error ends here, as one line or one JSON object.
    """
    console = Console(machine="--json" in arguments)
    DATA_ON_STDOUT.set(False)
    try:
        if not CORE.intersection(arguments[:1]):
            _add_extra_commands()
        code = app(arguments, prog_name="mark3dgs", standalone_mode=False)
        if code == failures.INTERRUPTED:  # typer has turned Ctrl-C into an exit code already
            raise KeyboardInterrupt
        return int(code or failures.OK)
    except BrokenPipeError:  # the reader of our output has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return failures.FAILED
    except (Exception, KeyboardInterrupt) as error:
        code = failures.exit_code(error)
        if code == failures.FAILED and os.environ.get("MARK3DGS_TRACEBACK"):
            raise
        found = failures.describe(error)
        console.note(f"mark3dgs: {found['message']}")
        if found["type"] == "UsageError":
            where = getattr(error, "ctx", None)  # the command that did not understand
            console.note(f"Try '{where.command_path if where else 'mark3dgs'} --help'.")
        console.emit({"error": found})
        return code


@cache
def _add_extra_commands() -> None:
    """Looked for where no command of the core is called: it takes a hundredth of a second or two."""
    add_extra_commands(app)


def main() -> None:
    """Entry point of the command."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is loaded; see engine.numerics.blas
    keep_freed_memory()
    gc.set_threshold(20_000)  # to start makes 100,000 objects and no garbage: to look through them took 70 ms
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()


EXTRAS = ("lab", "service")
"""Extras that bring commands; the entry points of each stand in the group `mark3dgs.commands.EXTRA`."""


def add_extra_commands(app: typer.Typer) -> None:
    """Add every extra's commands; those whose packages are missing are listed, and say so when called."""
    for extra in EXTRAS:
        found = entry_points(group=f"mark3dgs.commands.{extra}")
        missing = missing_packages(extra) if found else []
        for entry in sorted(found, key=lambda entry: (entry.module, entry.name)):
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


def _refusal(name: str, extra: str, missing: Sequence[str]) -> Callable[[], None]:
    def refuse() -> None:
        raise InputError(
            f"'mark3dgs {name}' needs the extra {extra!r} (missing: {', '.join(missing)}); "
            f"install it with: pip install 'mark3dgs[{extra}]'"
        )

    return refuse
