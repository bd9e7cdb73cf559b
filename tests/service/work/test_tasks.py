from __future__ import annotations

import json
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from engine.catalogue.entry import Entry
from engine.errors import CapacityError, FormatError, InputError
from engine.flows.records.opened_record import open_record
from engine.flows.warmup.warmup_steps import Step
from engine.formats import read_model, write_model
from engine.lab.sim.attacks import model_attack
from engine.registration.sketch import make_sketch
from engine.watermark.keys import OwnerKey
from engine.watermark.planning import PlanConfig
from engine.watermark.secret_cells import find_masses
from service.work.candidates import find_marks
from service.work.embedding import embed_mark
from service.work.pictures import choose_view
from service.work.tasks import TASKS, preload
from tests.service.work.conftest import FOREIGN, KEY, Ask, Marked, silent

EMBED: dict[str, Any] = {
    "model": str(FOREIGN),
    "key": KEY,
    "message": None,
    "bits": 16,
    "profile": "fast",
    "psnr": 30.0,
    "budget": None,
    "output": None,
    "format": None,
    "copy": "",
    "cameras": None,
    "spz_frame": "auto",
    "registered_at": "",
}


def test_importing_the_tasks_is_cheap_and_preloading_needs_no_torch() -> None:
    code = (
        "import sys, service.work.tasks as t; assert 'numpy' not in sys.modules;"
        "import service.work.verification, service.work.embedding, service.work.files;"
        "assert 'torch' not in sys.modules and 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_process_that_is_wanted_loads_no_more_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    ran = list[str]()
    steps = {name: Step(partial(ran.append, name), 1.0, ()) for name in ("first", "second")}
    monkeypatch.setattr("engine.flows.warmup.kernel_warmup.steps_of", lambda work: steps)
    preload(lambda: True)
    assert ran == ["first"]
    preload(lambda: False)
    assert ran == ["first", "first", "second"]


def test_embed_makes_all_that_its_contract_names(marked: Marked) -> None:
    reply = marked.reply
    json.dumps(reply)
    assert (reply["message"], reply["format"], reply["original_format"]) == ("c0ffee42", "ply", "splat")
    assert reply["report"]["psnr_worst_view"] > 46.9
    assert reply["report"]["bytes_out"] == marked.path("model").stat().st_size
    model, original = read_model(marked.path("model")).model, read_model(marked.original).model
    moved = (model.sh[:, 0] != original.sh[:, 0]).any(axis=1)
    assert moved[~find_masses(original.sh[:, 0], PlanConfig().mass_share)].mean() > 0.99
    opened = open_record(marked.path("record").read_bytes(), OwnerKey(bytes.fromhex(KEY)))
    assert (opened.copy, opened.header.record_id) == ("acme", reply["record_id"])
    # The sketch is that of the published model; what pictures show is the reference's.
    entry = Entry.from_bytes(marked.path("sketch").read_bytes())
    np.testing.assert_array_equal(entry.sketch.means, make_sketch(model).means)
    assert entry.seen is not None
    assert len(entry.seen) > 500


@pytest.mark.long
def test_auto_says_what_it_chose_and_keeps_the_fidelity_that_was_asked_for(tmp_path: Path, marked: Marked) -> None:
    reply = embed_mark(EMBED | {"model": str(marked.original), "profile": "auto", "psnr": 44.0}, tmp_path, silent)
    choice = reply["report"]["choice"]
    assert (choice["views"], choice["view_size"], choice["psnr_db"]) == (6, 256, 44.0)
    assert reply["report"]["seconds_by_stage"]["choose"] > 0.0
    assert open_record((tmp_path / reply["files"]["record"]).read_bytes(), OwnerKey(bytes.fromhex(KEY)))


def test_preview_shows_original_marked_and_difference(marked: Marked) -> None:
    with Image.open(marked.path("preview")) as picture:
        assert picture.width <= 1200
        levels = np.asarray(picture.convert("RGB"), dtype=np.int32)[24:]
    width = (levels.shape[1] - 12) // 3
    original, marked_, change = (levels[:, k * (width + 6) :][:, :width] for k in range(3))
    assert original.std() > 30  # something is to be seen
    assert 0 < np.abs(original - marked_).mean() < 2
    expected = np.clip(127.5 + 20 * (marked_ - original), 0, 255)
    # Within what rounding to 8 bits twice leaves, twenty times enlarged.
    assert np.abs(change - expected).max() <= 21


def test_the_view_shows_the_whole_model_and_needs_no_key(marked: Marked) -> None:
    original = read_model(marked.original).model
    camera, same = choose_view(original, 640, 480), choose_view(original, 640, 480)
    np.testing.assert_array_equal(camera.viewmat, same.viewmat)
    x = original.means[::50] @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    pixel = x @ camera.K.T
    at = pixel[:, :2] / pixel[:, 2:]
    inside = (x[:, 2] > 0) & (at > 0).all(axis=1) & (at < [640, 480]).all(axis=1)
    assert inside.mean() > 0.9


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"bits": 256, "psnr": 60.0}, CapacityError),
        ({"bits": 17}, InputError),
        ({"message": "zz"}, InputError),
        ({"profile": "best"}, InputError),
        ({"psnr": 5.0}, InputError),
        ({"budget": 200.0}, InputError),
        ({"output": "tiny"}, InputError),
        ({"model": __file__}, FormatError),
    ],
    ids=str,
)
def test_embed_refuses_and_leaves_nothing(tmp_path: Path, changes: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        embed_mark(EMBED | changes, tmp_path, silent)
    assert list(tmp_path.iterdir()) == []


def test_convert_writes_every_format(marked: Marked, tmp_path: Path) -> None:
    for kind in ("splat", "sog"):
        request = {"model": str(marked.path("model")), "format": kind}
        reply = TASKS["convert"](request, tmp_path, silent)
        loaded = read_model(tmp_path / reply["files"]["model"])
        assert (loaded.format, len(loaded.model)) == (kind, marked.reply["report"]["gaussians_out"])


def test_inspect_says_what_an_upload_is(inspect: Ask) -> None:
    reply = inspect(FOREIGN)
    assert (reply["format"], reply["gaussians"], reply["sh_degree"]) == ("ply", 1000, 3)
    assert (reply["bytes"], reply["sha256"]) == (FOREIGN.stat().st_size, read_model(FOREIGN).sha256)


def test_a_registered_mark_is_found_and_only_that(marked: Marked, tmp_path: Path) -> None:
    piece = model_attack("crop").apply(read_model(marked.path("model")).model, 0.3, rng=1)
    stolen = model_attack("similarity").apply(piece, 3.0, rng=1)
    write_model(stolen, tmp_path / "stolen.ply")
    candidates = [
        marked.candidate("broken", record=FOREIGN),
        marked.candidate("gone", record=FOREIGN.parent / "nothing"),
        marked.candidate("strange", key="33" * 16 + "44" * 16),
        marked.candidate("mine"),
    ]
    found = find_marks({"model": str(tmp_path / "stolen.ply"), "candidates": candidates}, tmp_path, silent)
    assert [each["asset"] for each in found["carries"]] == ["mine"]
    assert found["carries"][0]["log10_false_claim"] < -100
    assert find_marks({"model": str(marked.original), "candidates": candidates}, tmp_path, silent)["carries"] == []


def test_who_waits_for_an_answer_waits_for_nothing_else(tmp_path: Path) -> None:
    """A process that was started for one request does not warm up for another, however late that one comes."""
    process = subprocess.Popen(
        [sys.executable, "-m", "service.work", "--prompt"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdin is not None
    assert process.stdout is not None
    limits = {"memory_bytes": 4 << 30, "cpu_seconds": 60, "file_bytes": 1 << 20}
    request = {"model": str(FOREIGN), "spz_frame": "auto"}
    envelope = {"task": "inspect", "request": request, "folder": str(tmp_path), "limits": limits}
    time.sleep(3.0)  # it has long been there, also on a busy machine
    process.stdin.write(json.dumps(envelope).encode() + b"\n")
    process.stdin.flush()
    lines = [json.loads(line) for line in process.stdout]
    process.stdin.close()
    assert process.wait(10) == 0
    assert [line.get("stage") for line in lines[:-1]] == ["read"]
    assert lines[-1]["reply"]["gaussians"] == 1000
