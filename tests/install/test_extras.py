"""What a missing extra says, and that nothing of the core imports an extra's package."""

from __future__ import annotations

import ast
import json
import sys
from importlib.metadata import EntryPoint, EntryPoints

import pytest
import typer

from engine.cli import app as commands
from engine.cli.app import run
from engine.errors import InputError
from engine.extras import load_extra
from engine.lab.evaluate.perceptual.perceptual_cells import flip_map
from tests.architecture.tree import module_name, parse, product_files
from tests.install.distributions import closure, import_names

OF_AN_EXTRA = {
    "engine.catalogue": "service",
    "engine.credentials": "c2pa",
    "engine.formats.usd": "usd",
    "engine.lab": "lab",
    "service": "service",
    "service.client": "client",
}
"""Rooms that are an extra's, the nearest counts; everything else is the core's."""
OURS = {"engine", "service", "mark3dgs", "_typeshed", "backports", "compression"}
"""And what is there for types, or in Python itself from 3.14 on and before that in a namespace that many share."""
LATER = {"torch": "train", "gsplat": "cuda"}
"""Imported inside functions or by modules that only such functions import, behind a message of their own."""
STUDIES = {"distributed", "imwatermark", "kiss_icp", "laspy", "lazrs", "lpips", "lzf", "onnxruntime", "pycolmap"}
"""What single studies and the capture import, behind a message of their own."""


def imported(tree: ast.Module) -> set[str]:
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return (
        names
        - set(sys.stdlib_module_names)
        - {"engine", "service", "mark3dgs", "_typeshed", "backports", "compression"}
    )


def test_each_room_imports_what_its_extra_brings() -> None:
    """Of all imports, the late ones too: else a user has installed what is documented, and it breaks in the middle."""
    astray = {}
    for path in product_files():
        name = module_name(path)
        rooms = [room for room in OF_AN_EXTRA if name == room or name.startswith(room + ".")]
        extras = (OF_AN_EXTRA[max(rooms, key=len)],) if rooms else ()
        allowed = import_names(closure(*extras)) | set(LATER) | (STUDIES if extras == ("lab",) else set())
        if extra := imported(parse(path)) - allowed:
            astray[name] = extra
    assert astray == {}


def test_a_missing_package_is_said_with_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)  # as if it were not there
    import numpy as np

    image = np.zeros((8, 8, 3), dtype=np.float32)
    with pytest.raises(InputError, match=r"^FLIP needs flip_evaluator, .*pip install 'mark3dgs\[lab\]'$"):
        flip_map(image, image)
    with pytest.raises(InputError, match=r"^work needs no_such_module, which is not installed: pip install"):
        load_extra("no_such_module", "lab", "work")


@pytest.fixture
def without_lab(monkeypatch: pytest.MonkeyPatch) -> typer.Typer:
    """The program where the extra `lab` has a command, and one package of it is not installed."""
    entry = EntryPoint("attack", "engine.lab.cli.attack_command:attack", "mark3dgs.commands.lab")
    wanted = ["numpy>=2", 'numpy>=2; extra == "lab"', 'no-such-package>=1.2; extra == "lab"']
    monkeypatch.setattr(commands, "requires", lambda _: wanted)
    monkeypatch.setattr(commands, "entry_points", lambda group: EntryPoints([entry] if group.endswith(".lab") else []))
    app = typer.Typer()
    app.callback()(lambda: None)
    monkeypatch.setattr("engine.cli.app.app", app)
    monkeypatch.setattr("engine.cli.app._add_extra_commands", lambda: commands.add_extra_commands(app))
    return app


@pytest.mark.parametrize("words", [["--help"], [], ["model.ply", "out.ply", "--attack", "crop=0.5"]])
@pytest.mark.usefixtures("without_lab")
def test_a_command_without_its_extra_says_what_to_install(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["attack", *words, "--json"]) == 2
    said = json.loads(capsys.readouterr().out)["error"]["message"]
    assert "mark3dgs attack" in said
    assert "no-such-package" in said
    assert "pip install 'mark3dgs[lab]'" in said
    assert "numpy" not in said


@pytest.mark.usefixtures("without_lab")
def test_help_lists_a_command_with_the_extra_that_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "attack" in line)
    assert "Needs mark3dgs[lab]." in line
