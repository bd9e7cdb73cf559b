"""The core's commands in one process: `python main_job.py SCENE FOLDER [PACKAGE ...]`, which may not be imported.

The last line printed is one JSON object: each command's exit code and answer. Needs nothing but the installed core.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from importlib.abc import MetaPathFinder
from pathlib import Path


class Refusal(MetaPathFinder):
    """As if these packages were not installed."""

    def __init__(self, packages: Sequence[str]) -> None:
        self.packages = frozenset(packages)

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """ModuleNotFoundError where the module is of such a package."""
        if name.partition(".")[0] in self.packages:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def main(scene: str, folder: str, *refused: str) -> None:
    """Run the commands and print what they answer."""
    sys.meta_path.insert(0, Refusal(refused))
    from engine.cli.app import run

    def command(*words: str) -> dict[str, object]:
        said = io.StringIO()
        with redirect_stdout(said):
            code = run([*words, "--json"])
        return {"code": code, **json.loads(said.getvalue() or "{}")}

    at = Path(folder)
    key, record, marked = str(at / "owner.key"), str(at / "scene.record"), str(at / "marked.ply")
    picture, spz = str(at / "view.png"), str(at / "marked.spz")
    sealed = ("--key", key, "--record", record)
    answers = {
        "keygen": command("keygen", key),
        "embed": command("embed", scene, marked, *sealed, "--profile", "fast", "--bits", "32"),
        "inspect": command("inspect", marked),
        "convert": command("convert", marked, spz),
        "render": command("render", marked, picture, "--size", "640", "480"),
        "verify a model": command("verify", spz, *sealed),
        "verify a picture": command("verify", picture, *sealed),
        "verify the original": command("verify", scene, *sealed),
        "refine": command(
            "embed", scene, str(at / "refined.ply"), "--key", key, "--record", str(at / "refined"), "--profile", "paper"
        ),
    }
    sys.stdout.write(json.dumps(answers) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
