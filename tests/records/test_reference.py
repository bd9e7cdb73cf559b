"""The canonical reference: a projection, close to the model, strict about what it opens."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.errors import InputError, MalformedRecordError
from engine.model import GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.records.reference import decode_reference, encode_reference, reference_digest


def scene(n: int = 3000, degree: int = 3, seed: int = 0, reach: float = 5.0) -> GaussianModel:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return GaussianModel(
        rng.normal(size=(n, 3)) * reach,
        rng.normal(-5, 1.5, size=(n, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        rng.normal(size=n) * 3,
        rng.normal(size=(n, (degree + 1) ** 2, 3)) * 0.15 * (1 + 4 * (rng.uniform(size=(n, 1, 1)) < 0.01)),
    )


def same(a, b) -> bool:
    return a.keys() == b.keys() and all(a[k].dtype == b[k].dtype and np.array_equal(a[k], b[k]) for k in a)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("reach", [1e-4, 5.0, 1e7])
def test_encoding_is_a_projection(degree: int, reach: float) -> None:
    model = scene(degree=degree, reach=reach)
    arrays = encode_reference(model)
    again = encode_reference(decode_reference(arrays))
    assert same(arrays, again)
    assert reference_digest(arrays) == reference_digest(again)


def test_awkward_values_project_too() -> None:
    """Outliers beyond every range, ties among quaternion components, zero and negated quaternions."""
    base = scene(64)
    means, scales, quats = base.means.copy(), base.log_scales.copy(), base.quats.copy()
    logits, sh = base.opacity_logits.copy(), base.sh.copy()
    means[0], means[1] = (3e38, -3e38, 1e38), (1e-40, 0, -0.0)
    scales[0], scales[1] = (-200, 99, 0), (-32, 32, 31.999)
    quats[0], quats[1], quats[2] = (0, 0, 0, 0), (0.5, -0.5, 0.5, -0.5), (-1, 0, 0, 0)
    quats[3] = np.array([0.5, -0.50012, 0.50005, -0.49998])
    logits[0], logits[1] = 1e30, -90
    sh[0], sh[1], sh[2] = 1e6, -1e6, 0.99609375
    model = GaussianModel(means, scales, quats, logits, sh)
    arrays = encode_reference(model)
    back = decode_reference(arrays)
    assert same(arrays, encode_reference(back))
    assert back.quats[0].tolist() == [1, 0, 0, 0]
    assert back.quats[2].tolist() == [1, 0, 0, 0]
    assert np.array_equal(back.means[0], means[0])
    assert np.isfinite(back.sh).all()
    one = encode_reference(base.take(np.array([5])))
    assert same(one, encode_reference(decode_reference(one)))


def test_errors_stay_below_half_a_step() -> None:
    model = scene()
    back = decode_reference(encode_reference(model))
    typical = math.exp(float(np.quantile(model.log_scales.max(axis=1), 0.1)))
    assert np.abs(back.means - model.means).max() <= typical * 2**-12
    assert np.abs(back.log_scales - model.log_scales).max() <= 0.5001 / 256
    assert np.abs(back.opacity_logits - model.opacity_logits).max() <= 0.5001 / 128
    assert np.abs(back.sh[:, 0] - model.sh[:, 0]).max() <= 0.5001 / 512
    assert np.abs(back.sh[:, 1:] - model.sh[:, 1:]).max() <= 0.5001 / 256  # also beyond the one-byte range
    assert np.abs(model.sh[:, 1:]).max() > 127 / 256
    assert np.abs((back.quats * model.quats).sum(axis=1)).min() > 1 - 2 * (1 / 2047) ** 2
    assert np.abs(np.linalg.norm(back.quats, axis=1) - 1).max() < 1e-6


def test_turns_are_divided_as_single_precision_does() -> None:
    """On every machine the same bits, whatever freedom kernels have."""
    arrays = encode_reference(scene(5000))
    largest, planes = arrays["quat_largest"], arrays["quats"].astype(np.int64)
    others = (planes[0] + 256 * planes[1]).T - 2047
    whole = np.full((5000, 4), 2047, dtype=np.float32)
    whole[np.arange(4) != largest[:, None]] = others.reshape(-1)
    wanted = whole / np.sqrt(np.square(whole).sum(axis=1, keepdims=True))
    np.testing.assert_array_equal(decode_reference(arrays).quats, wanted)


def test_a_stray_gaussian_does_not_coarsen_the_others() -> None:
    model = scene(500)
    means = model.means.copy()
    means[7] = (2e8, -3e8, 1e3)
    arrays = encode_reference(model.with_(means=means))
    back = decode_reference(arrays)
    assert same(arrays, encode_reference(back))
    assert np.abs(back.means - means)[np.arange(500) != 7].max() < 1e-5
    assert np.array_equal(back.means[7, :2], means[7, :2])


def test_renders_keep_60_db() -> None:
    model = scene(3000, reach=0.3)
    back = decode_reference(encode_reference(model))
    for eye in ((0, 0, -2), (1.5, -1, 0.5)):
        camera = look_at(eye, (0, 0, 0), (0, -1, 0), 160, 160, 120)
        plain = render(model, camera)
        assert plain.std() > 0.05
        assert psnr(plain, render(back, camera)) >= 60


def test_size() -> None:
    arrays = encode_reference(scene(20_000))
    # Before compression; 57 bytes after it, on real scenes.
    assert sum(a.nbytes for a in arrays.values()) < 85 * 20_000


def test_order_and_every_value_enter_the_digest() -> None:
    model = scene(200, degree=1)
    digest = reference_digest(encode_reference(model))
    changed = {digest}
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        array = getattr(model, name).copy()
        array.reshape(200, -1)[7, -1] += 0.5
        changed.add(reference_digest(encode_reference(model.with_(**{name: array}))))
    changed.add(reference_digest(encode_reference(model.take(np.arange(200)[::-1]))))
    changed.add(reference_digest(encode_reference(model.take(np.arange(199)))))
    assert len(changed) == 8
    row = decode_reference(encode_reference(model)).means
    assert np.abs(row - model.means).max() < 1e-3  # row order is kept


def test_unusable_models_are_refused() -> None:
    model = scene(10)
    with pytest.raises(InputError, match="empty"):
        encode_reference(model.take(np.arange(0)))
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        for bad in (np.nan, np.inf, -np.inf):
            array = getattr(model, name).copy()
            array.reshape(-1)[3] = bad
            with pytest.raises(InputError, match=name):
                encode_reference(model.with_(**{name: array}))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("grid", lambda a: a.astype(np.int32)),
        ("grid", lambda a: a[:6]),
        ("grid", lambda a: a + np.array([1, 0, 0, 0, 0, 0, 0])),
        ("grid", lambda a: a + np.array([0, 1, 0, 0, 0, 0, 0])),
        ("grid", lambda a: a - np.array([0, 0, 1, 0, 0, 0, 0])),
        ("grid", lambda a: a + np.array([0, 0, 0, 500, 0, 0, 0])),
        ("grid", lambda a: np.array([*a[:3], 128, *a[4:]])),
        ("means", lambda a: a[:, :2]),
        ("means", lambda a: np.zeros((8, *a.shape[1:]), np.uint8)),
        ("means", lambda a: np.full((7, *a.shape[1:]), 255, np.uint8)),
        ("grid", lambda a: np.array([*a[:4], -(1 << 62), *a[5:]])),
        ("log_scales", lambda a: np.full_like(a, 255)),
        ("opacity_logits", lambda a: a.astype(np.int16)),
        ("dc", lambda a: a[0]),
        ("quats", lambda a: np.full_like(a, 255)),
        ("quat_largest", lambda a: a + 3),
        ("quat_largest", lambda a: a[:-1]),
        ("rest", lambda a: a[:-1]),
        ("rest", lambda a: np.full_like(a, 255)),
        ("rest_escape", lambda a: a[:-1]),
        ("rest_escape", lambda a: np.zeros_like(a)),
        ("rest_escape", lambda a: a[None]),
    ],
)
def test_malformed_references_are_refused(name: str, change) -> None:
    arrays = encode_reference(scene(500))
    assert len(arrays["rest_escape"])
    with pytest.raises(MalformedRecordError):
        decode_reference({**arrays, name: change(arrays[name])})


def test_missing_and_extra_arrays_are_refused() -> None:
    arrays = encode_reference(scene(5))
    with pytest.raises(MalformedRecordError, match="holds"):
        decode_reference({k: v for k, v in arrays.items() if k != "dc"})
    with pytest.raises(MalformedRecordError, match="holds"):
        decode_reference({**arrays, "more": arrays["dc"]})
