"""Streamed SOG: the finest rows of every leaf come in, chunks and index go out, and an index that lies is refused."""

from __future__ import annotations

import json
import shutil
import zipfile
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.formats import read_model
from engine.formats.sog.bundle import read_sog
from engine.formats.sog.chunks import write_streamed
from engine.formats.sog.levels import parse_lod_meta
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel
from tests.formats.damage import JUNK, MUTATIONS, mutated, places, survives, with_value
from tests.formats.models import assert_same, random_model


def sorted_by_place(model: GaussianModel) -> GaussianModel:
    return model.take(np.lexsort(model.means.T))


def zipped(folder: Path, top: str = "") -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, top + path.relative_to(folder).as_posix())
    return buffer.getvalue()


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Two levels in leaves of at most 200."""
    fine = random_model(1, 600)
    coarse = model_attack("merge").apply(fine, 0.25, rng=0, reading="as_code")
    write_streamed([fine, coarse], tmp_path, leaf=200)
    return tmp_path


def index_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "lod-meta.json").read_text()))


def test_the_finest_level_comes_back(scene: Path) -> None:
    index = index_of(scene)
    assert (index["version"], index["lodLevels"], index["counts"]) == (1, 2, [600, 150])
    assert index["count"] == 750
    assert index["filenames"][0] == "0_0/meta.json"
    loaded = read_model(scene)
    assert (loaded.format, [repair.code for repair in loaded.repairs]) == ("sog", ["levels_left_out"])
    assert "150 Gaussians of coarser levels" in loaded.repairs[0].text
    model, expected = sorted_by_place(loaded.model), sorted_by_place(random_model(1, 600))
    np.testing.assert_allclose(model.means, expected.means, atol=2e-3)
    np.testing.assert_allclose(model.opacities, expected.opacities, atol=0.51 / 255)
    files = [path for path in scene.rglob("*") if path.is_file()]
    assert loaded.source_bytes == sum(path.stat().st_size for path in files)
    assert read_model(scene / "lod-meta.json").sha256 == loaded.sha256
    for top in ("", "scene/"):
        assert_same(read_model(zipped(scene, top)).model, loaded.model)


def test_every_leaf_is_bounded_and_every_gaussian_in_one(scene: Path) -> None:
    leaves = []

    def walk(node: dict[str, Any]) -> None:
        low, high = (np.array(node["bound"][end]) for end in ("min", "max"))
        for child in node.get("children", []):
            assert (np.array(child["bound"]["min"]) >= low).all()
            assert (np.array(child["bound"]["max"]) <= high).all()
            walk(child)
        leaves.extend([node] if "lods" in node else [])

    walk(index_of(scene)["tree"])
    assert len(leaves) == 4
    for leaf in leaves:
        assert sum(rows["count"] for rows in leaf["lods"].values()) <= 200
        for level, rows in leaf["lods"].items():
            name = index_of(scene)["filenames"][rows["file"]]
            assert name.startswith(f"{level}_")
            chunk = read_model((scene / name).parent).model
            assert len(chunk) == rows["count"]
            assert (chunk.means >= np.array(leaf["bound"]["min"]) - 1e-3).all()
            assert (chunk.means <= np.array(leaf["bound"]["max"]) + 1e-3).all()


def test_the_same_scene_gives_the_same_bytes(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    again = tmp_path_factory.mktemp("again")
    fine = random_model(1, 600)
    written = write_streamed([fine, model_attack("merge").apply(fine, 0.25, rng=0, reading="as_code")], again, leaf=200)
    assert zipped(again)
    assert written == sum(path.stat().st_size for path in again.rglob("*") if path.is_file())
    for path in again.rglob("*"):
        assert path.is_dir() or path.read_bytes() == (scene / path.relative_to(again)).read_bytes()


def test_runs_of_rows_in_one_chunk_and_surroundings(tmp_path: Path) -> None:
    """As splat-transform writes: several leaves share a file, one leaf is only there coarsely, and a sky around."""
    for name, seed in (("0_0", 1), ("1_0", 2), ("env", 3)):
        made = tmp_path / "made"
        made.mkdir()
        write_streamed([random_model(0, 100, seed)], made)
        shutil.move(made / "0_0", tmp_path / name)
        shutil.rmtree(made)
    tree = {
        "bound": {"min": [0, 0, 0], "max": [1, 1, 1]},
        "children": [
            {"lods": {"0": {"file": 0, "offset": 0, "count": 30}, "1": {"file": 1, "offset": 0, "count": 40}}},
            {"lods": {"0": {"file": 0, "offset": 50, "count": 50}}, "errors": [0, 1]},
            {"lods": {"1": {"file": 1, "offset": 40, "count": 60}}},
        ],
    }
    index = {"lodLevels": 2, "filenames": ["0_0/meta.json", "1_0/meta.json"], "tree": tree}
    index["environment"] = "env/meta.json"
    (tmp_path / "lod-meta.json").write_text(json.dumps(index))
    loaded = read_model(tmp_path)
    fine, coarse, sky = (read_model(tmp_path / name).model for name in ("0_0", "1_0", "env"))
    expected = [fine.take(np.r_[0:30, 50:100]), coarse.take(np.arange(40, 100)), sky]
    np.testing.assert_array_equal(loaded.model.means, np.concatenate([part.means for part in expected]))
    assert loaded.repairs[0].count == 40


def test_levels_must_agree(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="antialiased, or none"):
        write_streamed([random_model(0, 20), replace(random_model(0, 10), antialiased=True)], tmp_path)
    with pytest.raises(InputError, match="in every level"):
        write_streamed([random_model(0, 20), random_model(0, 1).take(np.arange(0))], tmp_path)
    write_streamed([replace(random_model(0, 20), antialiased=True)], tmp_path)
    assert read_model(tmp_path).model.antialiased


LEAF = {"lods": {"0": {"file": 0, "offset": 0, "count": 20}}}
INDEX: dict[str, Any] = {"version": 1, "count": 20, "counts": [20], "lodLevels": 1, "filenames": ["0_0/meta.json"]}
INDEX["tree"] = {"children": [LEAF]}


def parts_of_a_chunk(tmp: Path) -> dict[str, bytes]:
    write_streamed([random_model(0, 20)], tmp)
    return {path.name: path.read_bytes() for path in (tmp / "0_0").iterdir()}


@pytest.fixture(scope="module")
def chunk(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return parts_of_a_chunk(tmp_path_factory.mktemp("chunk"))


def bundle(index: Any, chunk: dict[str, bytes]) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("lod-meta.json", index if isinstance(index, bytes) else json.dumps(index))
        for name, part in chunk.items():
            archive.writestr(f"0_0/{name}", part)
    return buffer.getvalue()


def changed(*path: Any, value: Any) -> dict[str, Any]:
    return dict(with_value(INDEX, path, value))


ROWS = ("tree", "children", 0, "lods", "0")
DEEP = b'{"lodLevels":1,"filenames":["a/meta.json"],"tree":' + b'{"children":[' * 50_000


@pytest.mark.parametrize(
    ("index", "what"),
    [
        (changed("version", value=2), "version 2, read is 1"),
        (changed("lodLevels", value=0), "no number of levels"),
        (changed("lodLevels", value=10**6), "no number of levels"),
        (changed("filenames", value=[]), "must list the chunks"),
        (changed("filenames", 0, value="../0_0/meta.json"), "no plain path"),
        (changed("filenames", 0, value="/etc/meta.json"), "no plain path"),
        (changed("filenames", 0, value="0_0/other.json"), "no plain path"),
        (changed("filenames", 0, value="absent/meta.json"), "lacks this entry"),
        (changed("environment", value="..%2Fmeta.json"), "no plain path"),
        (changed("counts", value=[21]), r"holds \[20\] Gaussians, the index says \[21\]"),
        (changed("tree", value=5), "no object with children"),
        (changed("tree", value={"children": []}), "no leaf with rows"),
        (changed(*ROWS, "file", value=1), "of 1 files"),
        (changed(*ROWS, "offset", value=-1), "of 1 files"),
        (changed(*ROWS, "count", value=1.5), "of 1 files"),
        (changed(*ROWS, "offset", value=1), "rows 1 to 21; the chunk holds 20"),
        (changed("tree", "children", 0, "lods", value={"1": {}}), "level '1', there are 1"),
        (changed("tree", "children", 0, "lods", value={"00": {}}), "level '00', there are 1"),
        (b"[]", "no JSON object"),
        (DEEP, "is no JSON"),
    ],
)
def test_an_index_that_lies_is_refused_by_name(index: Any, what: str, chunk: dict[str, bytes]) -> None:
    assert len(read_sog(bundle(INDEX, chunk), file="x")[0]) == 20
    with pytest.raises(FormatError, match=r"^scene\.zip.*" + what):
        read_sog(bundle(index, chunk), file="scene.zip")


def test_a_chunk_that_is_asked_for_very_often_is_read_once(chunk: dict[str, bytes]) -> None:
    index = changed("tree", value={"children": [LEAF] * 10_000}) | {"counts": [200_000], "count": 200_000}
    assert len(read_sog(bundle(index, chunk), file="x")[0]) == 20


def test_folders_without_an_index(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedFormatError, match=r"without meta\.json or lod-meta\.json"):
        read_model(tmp_path)


@settings(max_examples=300)
@given(st.sampled_from(places(INDEX)[1:]), JUNK)
def test_an_index_that_says_anything(path: tuple[Any, ...], junk: Any) -> None:
    with suppress(FormatError):
        parse_lod_meta(json.dumps(changed(*path, value=junk)).encode(), file="x")


@settings(max_examples=60)
@given(MUTATIONS)
def test_damaged_bytes_give_a_format_error_or_a_valid_model(
    chunk: dict[str, bytes], mutations: list[tuple[int, int]]
) -> None:
    survives(read_sog, mutated(bundle(INDEX, chunk), mutations))
