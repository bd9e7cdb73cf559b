"""The commands on machines as people have them: no home, folders that cannot be written, odd names, pipes."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from engine.formats import read_model
from tests.end_to_end.conftest import DATA

SCENE = DATA / "train_1000.ply"
COMMAND = [sys.executable, "-m", "engine.cli.app"]
pytestmark = pytest.mark.timeout(300)  # one compiles kernels, which nothing keeps
PLAIN_USER = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search"] if os.geteuid() == 0 else []
"""Before a command: root may write everywhere, unless it has lost what lets it."""
ODD = os.fsdecode(b"b\xe4d n\xc3\xa4me  x")
"""Blanks, an umlaut in UTF-8, and one in Latin-1, which is no UTF-8."""


def call(*arguments: str | Path, given: bytes = b"", **variables: str) -> subprocess.CompletedProcess[bytes]:
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **variables}
    environment.pop("MARK3DGS_WARNED_CACHE", None)
    return subprocess.run(
        [*PLAIN_USER, *COMMAND, *map(str, arguments)], input=given, capture_output=True, env=environment
    )


@pytest.fixture
def locked(tmp_path: Path) -> Path:
    """A folder with a scene in it that may only be read."""
    folder = tmp_path / "locked"
    folder.mkdir()
    (folder / "scene.ply").write_bytes(SCENE.read_bytes())
    folder.chmod(0o500)
    return folder


@pytest.fixture
def key(tmp_path: Path) -> Path:
    assert call("keygen", tmp_path / "k").returncode == 0
    return tmp_path / "k"


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene, its marked copy, key and record, of odd names."""
    folder = tmp_path_factory.mktemp("odd") / ODD
    folder.mkdir()
    source, mine = folder / f"{ODD}.ply", ("--key", folder / "k", "--record", folder / f"{ODD}.record")
    source.write_bytes(SCENE.read_bytes())
    assert call("keygen", folder / "k").returncode == 0
    done = call("embed", source, folder / f"{ODD} m.ply", *mine, "--profile", "fast")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.long  # it compiles every kernel: .ci/run does, beside the tests of installing
def test_without_a_home_and_a_cache_the_mark_is_found(locked: Path, odd: Path) -> None:
    machine = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/nonexistent", "NUMBA_CACHE_DIR": str(locked)}
    mine = ("--key", odd / "k", "--record", odd / f"{ODD}.record")
    found = call("verify", odd / f"{ODD} m.ply", *mine, **machine)
    assert (found.returncode, b"Watermark found" in found.stdout) == (0, True), found.stderr
    assert found.stderr.decode().count("set NUMBA_CACHE_DIR to a folder that can be written") == 1


@pytest.mark.parametrize("place", ["model", "record"])
def test_a_folder_that_cannot_be_written_is_named_before_the_work(
    tmp_path: Path, locked: Path, key: Path, place: str
) -> None:
    model = locked / "m.ply" if place == "model" else tmp_path / "m.ply"
    record = locked / "r" if place == "record" else tmp_path / "r"
    # A model that is none: that it was not even read shows in the message.
    (tmp_path / "none.ply").write_bytes(b"none")
    done = call("embed", tmp_path / "none.ply", model, "--key", key, "--record", record)
    assert done.returncode == 2
    assert f"may not write in the folder '{locked}'" in done.stderr.decode()
    assert not model.exists()
    assert not record.exists()
    assert [each.name for each in locked.iterdir()] == ["scene.ply"]


def test_new_folders_and_pictures_are_refused_alike(locked: Path) -> None:
    for arguments in (("convert", SCENE, locked / "new" / "lod-meta.json"), ("render", SCENE, locked / "picture.png")):
        done = call(*arguments)
        assert (done.returncode, b"may not write in the folder" in done.stderr) == (2, True)


def test_odd_names_work_in_every_locale(tmp_path: Path, odd: Path) -> None:
    folder, source = odd, odd / f"{ODD}.ply"
    for locale in ({"LC_ALL": "C.UTF-8"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}):
        done = call("inspect", source, "--json", **locale)
        assert os.fsencode(json.loads(done.stdout)["file"]) == os.fsencode(source)
        done = call("convert", source, tmp_path / f"{ODD}.spz", **locale)
        assert (done.returncode, len(read_model(tmp_path / f"{ODD}.spz").model)) == (0, 1000), done.stderr
    mine = ("--key", folder / "k", "--record", folder / f"{ODD}.record")
    found = call("verify", folder / f"{ODD} m.ply", *mine)
    assert (found.returncode, b"Watermark found" in found.stdout) == (0, True), found.stderr


def test_the_longest_name_that_a_file_may_have(tmp_path: Path) -> None:
    target = tmp_path / ("\u00e4" * 125 + ".spz")
    done = call("convert", SCENE, target)
    assert (done.returncode, target.is_file()) == (0, True), done.stderr


def test_a_device_is_no_target(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    done = call("convert", SCENE, tmp_path / "pipe.ply")
    assert (done.returncode, b"device or a pipe" in done.stderr) == (2, True)


def test_pipes_carry_files(tmp_path: Path, odd: Path) -> None:
    written = tmp_path / "a.spz"
    assert call("convert", SCENE, written).returncode == 0
    for more in ((), ("--json",)):
        piped = call("convert", "-", "-", "--to", "spz", *more, given=SCENE.read_bytes())
        assert (piped.returncode, piped.stdout) == (0, written.read_bytes())
    assert json.loads(piped.stderr)["format_out"] == "spz"
    assert call("convert", SCENE, "-", "--to", "glb", "--rights", "mine").stdout.startswith(b"glTF")
    seen = json.loads(call("inspect", "-", "--json", given=written.read_bytes()).stdout)
    assert (seen["file"], seen["format"], seen["gaussians"]) == ("-", "spz", 1000)
    mine = ("--key", odd / "k", "--record", odd / f"{ODD}.record")
    found = call("verify", "-", *mine, "--json", given=(odd / f"{ODD} m.ply").read_bytes())
    said = json.loads(found.stdout)
    assert (said["verdict"], said["suspects"]) == ("marked", ["-"])


@pytest.mark.parametrize(
    ("arguments", "given", "message"),
    [
        (("convert", "-", "-"), b"x", "name the format with --to"),
        (("convert", "-", "-", "--to", "ksplat"), b"x", "ends in none of"),
        (("convert", "-", "out.ply"), b"", "standard input: is empty"),
        (("inspect", "-", "--from", "spz"), SCENE.read_bytes(), "standard input: is ply, not 'spz' as --from says"),
        (("inspect", "-"), b"\x1f\x8b cut off", "standard input: "),
        (("verify", "-", "-", "--key", "k", "--record", "r"), b"", "standard input is one suspect"),
    ],
)
def test_refusals_leave_standard_output_empty(arguments: tuple[str, ...], given: bytes, message: str) -> None:
    done = call(*arguments, given=given)
    assert (done.returncode, done.stdout) == (2, b"")
    assert message in done.stderr.decode()
    assert b"Traceback" not in done.stderr


def test_a_refusal_for_machines_does_not_stand_in_the_data() -> None:
    done = call("convert", "-", "-", "--to", "spz", "--json", given=b"nothing")
    assert (done.returncode, done.stdout) == (2, b"")
    assert json.loads(done.stderr)["error"]["type"] == "UnsupportedFormatError"


def test_terminals_get_and_give_no_files() -> None:
    ours, theirs = pty.openpty()
    try:
        for arguments, ends in ((("convert", SCENE, "-", "--to", "spz"), "stdout"), (("inspect", "-"), "stdin")):
            streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, ends: theirs}
            done = subprocess.run([*COMMAND, *map(str, arguments)], stderr=subprocess.PIPE, **streams)  # type: ignore[call-overload]
            assert (done.returncode, b"is a terminal" in done.stderr) == (2, True)
    finally:
        os.close(ours)
        os.close(theirs)
