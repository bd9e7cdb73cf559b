"""The command `mark3dgs`: its sub-commands, and the one place where errors become exit codes."""

import os
import sys
from typing import Annotated

import typer

from engine.cli import (
    attack,
    attest,
    bench,
    config,
    convert,
    credentials,
    demo,
    dispute,
    embed,
    evaluate,
    failures,
    inspect,
    keygen,
    render,
    sim,
    trace,
    verify,
)
from engine.cli.console import Console
from engine.numerics.allocating import keep_freed_memory

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
        from importlib.metadata import version

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

    Exit codes: 0 done, or marked; 3 not marked; 4 inconclusive; 2 wrong usage
    or input; 1 a fault of the program or the machine; 130 interrupted.

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
app.command("attack")(attack.attack)
app.command("sim")(sim.sim)
app.command("evaluate")(evaluate.evaluate)
app.command("bench", help=bench.HELP)(bench.bench)
app.add_typer(config.app, name="config")
app.add_typer(credentials.app, name="credentials")
app.command("demo")(demo.demo)


def run(arguments: list[str]) -> int:
    """Exit code of one command line (without the program's name).

    Every error ends here, as one line or one JSON object.
    """
    console = Console(machine="--json" in arguments)
    try:
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


def main() -> None:
    """Entry point of the command."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is loaded; see engine.numerics.blas
    keep_freed_memory()
    sys.exit(run(sys.argv[1:]))
