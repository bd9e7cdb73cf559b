"""The page's own files, without a browser."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from engine.formats import wrappings
from engine.formats.known_formats import KINDS

PICTURES = {"PNG", "JPEG", "BMP", "GIF", "TIFF", "WEBP", "AVIF"}
"""What `engine.formats.image_files.is_picture` knows."""
WEB = Path(__file__).parents[3] / "service" / "web"
SCRIPTS = sorted((WEB / "js").glob("*.js"))
PAGES = [WEB / "index.html", WEB / "docs" / "index.html"]
STYLES = [*sorted((WEB / "css").glob("*.css")), WEB / "docs" / "docs.css"]


@pytest.mark.parametrize("path", [*SCRIPTS, *STYLES, *PAGES], ids=lambda path: path.name)
def test_own_files_are_short_and_ask_no_other_host(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= 330
    assert not re.findall(r"(?:https?:)?//[\w-]+\.[\w.-]+", text)


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_imports_exist(path: Path) -> None:
    for names, target in re.findall(r"import (?:\{([^}]*)\} from )?\"(\.[^\"]+)\"", path.read_text()):
        source = (path.parent / target).resolve()
        assert source.is_file()
        for name in filter(None, (part.strip() for part in names.split(","))):
            assert re.search(
                rf"export (?:async )?(?:function\*?|class|const) {re.escape(name)}(?!\w)", source.read_text()
            ), name


def test_elements_that_scripts_name_are_on_the_page() -> None:
    page = (WEB / "index.html").read_text()
    ids = set(re.findall(r"\bid=\"([\w-]+)\"", page))
    for path in SCRIPTS:
        for name in re.findall(r"\$\(\"#([\w-]+)\"", path.read_text()):
            assert name in ids, f"{path.name}: #{name}"
    for view in ("mark", "check"):
        assert {f"{view}-{part}" for part in ("form", "intro", "progress", "result", "problem")} <= ids


def test_file_dialogs_offer_every_format_that_is_read() -> None:
    names = {f".{name}" for kind in KINDS for name in (kind.name.split(".")[-1], *kind.endings)}
    models = {*names, *wrappings._MODELS, ".zip", ".gz"}
    mark, check = (set(each.split(",")) for each in re.findall(r'accept="([^"]+)"', (WEB / "index.html").read_text()))
    assert mark == models - {".obj"}, "points and meshes are suspects alone"
    assert models <= check
    assert {Image.registered_extensions()[each] for each in check - models} == PICTURES


def test_profiles_say_the_seconds_that_were_measured() -> None:
    page, results = (WEB / "index.html").read_text(), (WEB.parents[1] / "docs" / "RESULTS.md").read_text()
    offered = re.findall(r'name="profile" value="(\w+)".*?<small>(\d+)(?: to (\d+))? s\.', page)
    assert [name for name, *_ in offered] == re.findall(r'name="profile" value="(\w+)"', page)
    for name, *said in offered:
        (times,) = re.findall(rf"^\| {name} \| ([\d. /]+) \|", results, re.MULTILINE)
        measured = [float(seconds) for seconds in times.split(" / ")]
        wanted = sorted({round(min(measured)), round(max(measured))})
        assert [int(seconds) for seconds in said if seconds] == wanted, name


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.parent.name)
def test_pages_hold_no_script_of_their_own(path: Path) -> None:
    text = path.read_text()
    assert not re.search(r"<script(?![^>]*\bsrc=)", text)
    assert not re.search(r"\son\w+=|\sstyle=", text)
    for asset in re.findall(r"(?:src|href)=\"/static/([^\"]+)\"", text):
        assert (WEB / asset).is_file(), asset


@pytest.mark.parametrize("folder", ["viewer/supersplat", "docs/swagger-ui"])
def test_what_others_wrote_keeps_its_licence_and_version(folder: str) -> None:
    assert len((WEB / folder / "LICENSE").read_text()) > 1000
    note = (WEB / folder).parent / "README.md"
    assert re.search(r"`[@\w/-]+` \d+\.\d+\.\d+", note.read_text())
