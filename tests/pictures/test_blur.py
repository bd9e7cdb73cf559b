"""Blur: found against a render, and left alone where a picture is sharp, noisy or compressed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from engine.flows.embed.profiles import profile
from engine.flows.verify.search import verify_images
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import MarkedScene, mark_scene
from engine.model import Camera, Float32
from engine.pictures.alignment.blur import Blur, find_blur
from engine.raster import render
from tests.scenes import sparse_plant

ALL = np.ones((360, 480), dtype=bool)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> MarkedScene:
    path = tmp_path_factory.mktemp("blur") / "plant.splat"
    path.write_bytes(sparse_plant(every=3))
    return mark_scene(path, profile("fast", landmark_views=0, views=3, view_size=256))


@pytest.fixture(scope="module")
def camera(scene: MarkedScene) -> Camera:
    return make_rig(scene.original, 2, 480, 360, jitter=np.random.default_rng(7).random((2, 4)))[1]


@pytest.fixture(scope="module")
def picture(scene: MarkedScene, camera: Camera) -> Float32:
    return np.clip(render(scene.marked, camera), 0.0, 1.0)


def kept(picture: Float32, quality: int = 0) -> Float32:
    """As a file keeps it: in 8 bits, or as a JPEG."""
    stored = np.round(np.clip(picture, 0.0, 1.0)[..., ::-1] * 255.0).astype(np.uint8)
    if quality:
        stored = cv2.imdecode(cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
    return np.asarray(stored[..., ::-1], dtype=np.float32) / np.float32(255.0)


@pytest.mark.parametrize("length", [5.0, 9.0, 15.0])
@pytest.mark.parametrize("degrees", [0.0, 37.0, 110.0])
def test_a_line_is_found(scene: MarkedScene, camera: Camera, picture: Float32, length: float, degrees: float) -> None:
    plain = np.clip(render(scene.original, camera), 0.0, 1.0)
    found = find_blur(plain, kept(Blur(length, np.deg2rad(degrees), 0.0).apply(picture)), ALL)
    assert found is not None
    assert found.length == pytest.approx(length, rel=0.1)
    off = (np.rad2deg(found.angle) - degrees + 90.0) % 180.0 - 90.0
    assert abs(off) < 5.0


@pytest.mark.parametrize("sigma", [1.2, 2.0, 3.0])
def test_a_lens_is_found(scene: MarkedScene, camera: Camera, picture: Float32, sigma: float) -> None:
    plain = np.clip(render(scene.original, camera), 0.0, 1.0)
    found = find_blur(plain, kept(Blur(0.0, 0.0, sigma).apply(picture)), ALL)
    assert found is not None
    assert found.sigma == pytest.approx(sigma, rel=0.1)


def test_sharp_noisy_and_compressed_pictures_have_none(scene: MarkedScene, camera: Camera, picture: Float32) -> None:
    plain = np.clip(render(scene.original, camera), 0.0, 1.0)
    noisy = picture + np.random.default_rng(1).normal(0.0, 0.1, picture.shape).astype(np.float32)
    laid_wrong = np.roll(picture, 2, axis=1)  # blur explains some of it, not most
    for seen in (picture, kept(noisy), kept(picture, 80), kept(picture, 10), 0.6 * picture + 0.2, laid_wrong):
        assert find_blur(plain, seen, ALL) is None
    assert find_blur(plain, Blur(0.0, 0.0, 2.0).apply(picture), np.zeros_like(ALL)) is None


def test_a_kernel_is_its_own_adjoint() -> None:
    rng = np.random.default_rng(2)
    a, b = (np.pad(rng.random((40, 50, 3)), ((20, 20), (20, 20), (0, 0))).astype(np.float32) for _ in range(2))
    for blur in (Blur(11.0, 0.7, 0.0), Blur(0.0, 0.0, 2.0)):
        assert blur.kernel.sum() == pytest.approx(1.0, abs=1e-5)
        assert float((blur.apply(a) * b).sum()) == pytest.approx(float((a * blur.apply(b)).sum()), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("blur", [Blur(12.0, 0.4, 0.0), Blur(0.0, 0.0, 2.5)])
def test_a_blurred_picture_is_read_with_its_blur(
    scene: MarkedScene, camera: Camera, picture: Float32, blur: Blur, monkeypatch: pytest.MonkeyPatch
) -> None:
    import engine.flows.verify.suspect_evidence as reading

    seen = kept(blur.apply(picture))
    z = verify_images([seen], scene.opened, cameras=[camera]).claim.z
    unmarked = kept(blur.apply(np.clip(render(scene.original, camera), 0.0, 1.0)))
    assert abs(verify_images([unmarked], scene.opened, cameras=[camera]).claim.z) < 5.0
    monkeypatch.setattr(reading, "find_blur", lambda *_: None)
    assert z > 1.5 * verify_images([seen], scene.opened, cameras=[camera]).claim.z
    assert z > 12.0
