"""The theorem's premise, on every route: what is read of a suspect does not change with chips, message or strength."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from engine.flows.embed.profiles import profile
from engine.flows.progress import Clock
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.search import Reading, Suspect, readings
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key, mark_copies
from engine.lab.sim.adversaries.laundering import smooth
from engine.lab.sim.attacks import model_attack
from engine.model import Float32
from engine.raster import render
from engine.watermark.keys import CHIPS
from engine.watermark.model_evidence import Evidence
from engine.watermark.spreading import spread
from tests.scenes import sparse_plant

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_renders")]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> MarkedScene:
    path = tmp_path_factory.mktemp("scene") / "plant.splat"
    path.write_bytes(sparse_plant())
    return mark_copies(path, profile("fast", landmark_views=0, views=2, view_size=192), ["a"])[0]


def drawn_anew(opened: OpenedRecord, seed: int) -> OpenedRecord:
    """The same plan with everything secret from another key, another message and another strength."""
    key = bench_key(1_000 + seed)
    layout = opened.layout
    return replace(
        opened,
        spreading=spread(key, bytes([seed]), layout.codes, len(layout.directions[0]), len(opened.message), sized=True),
        grain_key=key.derive(CHIPS, b"another"),
        message=(-opened.message).astype(np.int8),
        strength=opened.strength * 3.0,
    )


def suspects(scene: MarkedScene) -> dict[str, Suspect]:
    """Marked; moved, noised and thinned; two pictures of known cameras, one blurred and one a JPEG; one of a model
    with smoothed colors."""
    worn = model_attack("similarity").apply(scene.marked, 4.0, rng=2)
    for attack, strength in (("noise_all", 0.1), ("prune_random", 0.5)):
        worn = model_attack(attack).apply(worn, strength, rng=2)
    cameras = make_rig(scene.marked, 2, 320, 320)
    pictures = [np.clip(render(scene.marked, camera), 0.0, 1.0) for camera in cameras]
    pictures[0], pictures[1] = cv2.GaussianBlur(pictures[0], (0, 0), 2.0), as_jpeg(pictures[1])
    washed = np.clip(render(smooth(scene.marked, 32), cameras[0]), 0.0, 1.0)
    models = {name: Suspect(model) for name, model in {"marked": scene.marked, "worn": worn}.items()}
    seen = {"pictures": Suspect(None, pictures, cameras), "washed": Suspect(None, [washed], cameras[:1])}
    return models | seen


def as_jpeg(picture: Float32) -> Float32:
    stored = np.round(picture[..., ::-1] * 255).astype(np.uint8)
    coded = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, 50])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.float32)[..., ::-1] / np.float32(255)


def walk(suspect: Suspect, opened: OpenedRecord) -> list[Reading]:
    return list(readings(suspect, opened, suspect.routes("auto"), 0, Clock(None)))


Read = dict[str, tuple[Suspect, list[Reading]]]


@pytest.fixture(scope="module")
def kept() -> Read:
    return {}


@pytest.fixture
def read(scene: MarkedScene, kept: Read, small_renders: None) -> Read:
    """Each suspect, and what is read of it with the owner's record; once for all tests."""
    kept.update(kept or {name: (each, walk(each, scene.opened)) for name, each in suspects(scene).items()})
    return kept


def test_evidence_is_the_same_to_the_last_byte_whatever_the_chips_are(scene: MarkedScene, read: Read) -> None:
    routes = set()
    for name, (suspect, true) in read.items():
        assert any(note.startswith("blurred: picture 1") for note in true[0].notes) == (name == "pictures")
        assert any("averaged over neighbors" in note for note in true[0].notes) == (name == "washed")
        for one, other in zip(true, walk(suspect, drawn_anew(scene.opened, 1)), strict=True):
            a, b = one.evidence, other.evidence
            assert one.route == other.route
            assert a.y.tobytes() == b.y.tobytes(), (name, one.route)
            assert a.weights.tobytes() == b.weights.tobytes(), (name, one.route)
            assert (a.linear is None) == (b.linear is None)
            assert a.linear is None or (b.linear is not None and a.linear.tobytes() == b.linear.tobytes())
            assert a.weights.any()
            routes.add(one.route)
    assert routes == {"model", "both", "image"}


def test_evidence_of_the_copy_layer_is_the_same_whatever_its_chips_are(scene: MarkedScene, read: Read) -> None:
    """The owner's layer is taken off before; the copy's own values enter nothing."""
    opened = replace(scene.opened, copy_key=bytes(32))
    assert opened.copies is not None
    for name in ("marked", "pictures"):
        suspect, true = read[name]
        for one, other in zip(true, walk(suspect, opened), strict=True):
            assert one.copied is not None
            assert other.copied is not None
            assert one.copied.y.tobytes() == other.copied.y.tobytes(), (name, one.route)
            assert one.copied.weights.tobytes() == other.copied.weights.tobytes(), (name, one.route)


def test_the_test_would_see_a_leak(scene: MarkedScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evidence that a strength enters is distinguished."""
    import engine.flows.verify.search as searching

    read = searching.read_layers

    def leaking(suspect, opened, registration):  # type: ignore[no-untyped-def]
        evidence, copied = read(suspect, opened, registration)
        return Evidence(evidence.y * opened.strength, evidence.weights, evidence.signal), copied

    monkeypatch.setattr(searching, "read_layers", leaking)
    suspect = Suspect(scene.marked)
    one, other = (walk(suspect, opened)[0].evidence for opened in (scene.opened, drawn_anew(scene.opened, 1)))
    assert one.y.tobytes() != other.y.tobytes()
