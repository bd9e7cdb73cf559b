"""OpenUSD against the library's own view of a scene; what cannot be read is named."""

from __future__ import annotations

import importlib.util
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.formats import encode_model, read_model, write_model
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from tests.formats.models import random_model

HERE = importlib.util.find_spec("pxr") is not None
needs_usd = pytest.mark.skipif(not HERE, reason="usd-core is not installed: pip install 'mark3dgs[usd]'")
USDA = """#usda 1.0
def Xform "World"
{{
    {above}
    def ParticleField3DGaussianSplat "Splats"
    {{
        {body}
        point3f[] positions = [(0, 0, 0), (1, 0, 0)]
        quatf[] orientations = [(1, 0, 0, 0), (0, 1, 0, 0)]
        half3[] scalesh = [(1, 1, 1), (0.5, 0.25, 2)]
        float[] opacities = [0.5, 0.75]
        uniform int radiance:sphericalHarmonicsDegree = {degree}
        float3[] radiance:sphericalHarmonicsCoefficients = [{rest}]
    }}
}}
"""


def scene(degree: int = 0, above: str = "", body: str = "", coefficients: int | None = None) -> bytes:
    """Two Gaussians as text."""
    count = 2 * (degree + 1) ** 2 if coefficients is None else coefficients
    rest = ", ".join(f"({i}, {i + 0.25}, {-i})" for i in range(count))
    return USDA.format(above=above, body=body, degree=degree, rest=rest).encode()


@needs_usd
@pytest.mark.parametrize("kind", ["usda", "usdc", "usdz"])
@pytest.mark.parametrize("degree", [0, 3])
def test_a_model_goes_out_and_comes_back(kind: str, degree: int) -> None:
    model = random_model(degree, 300)
    data = encode_model(model, kind)
    assert data == encode_model(model, kind)
    loaded = read_model(data)
    assert (loaded.format, loaded.repairs) == (kind, ())
    for name in ("means", "quats", "sh"):
        np.testing.assert_array_equal(getattr(loaded.model, name), getattr(model, name))
    np.testing.assert_allclose(loaded.model.log_scales, model.log_scales, atol=2e-6)
    np.testing.assert_allclose(loaded.model.opacities, model.opacities, atol=1e-6)


@needs_usd
def test_what_is_written_is_what_the_library_sees(tmp_path: Path) -> None:
    """The oracle is the schema's own interface, which knows nothing of ours."""
    from pxr import Usd, UsdVol

    model = random_model(2, 40)
    write_model(model, tmp_path / "scene.usd")
    stage = Usd.Stage.Open(str(tmp_path / "scene.usd"))
    splat = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    assert splat.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 2
    quats = splat.GetOrientationsAttr().Get()
    np.testing.assert_array_equal([[q.GetReal(), *q.GetImaginary()] for q in quats], model.quats)
    np.testing.assert_array_equal(splat.GetPositionsAttr().Get(), model.means)
    np.testing.assert_array_equal(splat.GetScalesAttr().Get(), model.scales)
    np.testing.assert_array_equal(splat.GetRadianceSphericalHarmonicsCoefficientsAttr().Get()[9], model.sh[1, 0])
    low, high = np.array(splat.GetExtentAttr().Get())
    assert (low <= model.means.min(axis=0)).all()
    assert (high >= model.means.max(axis=0)).all()


@needs_usd
def test_half_floats_and_transforms() -> None:
    plain = read_model(scene(1)).model
    np.testing.assert_allclose(plain.scales, [[1, 1, 1], [0.5, 0.25, 2]], rtol=1e-6)
    np.testing.assert_array_equal(plain.sh[1, 2], [6, 6.25, -6])
    turn = "double3 xformOp:translate = (1, 2, 3)\n    float xformOp:rotateZ = 90\n"
    turn += '    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]'
    moved = read_model(scene(1, above=turn)).model
    expected = transform_model(plain, 1.0, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3])
    for name in ("means", "log_scales", "quats", "sh"):
        np.testing.assert_allclose(getattr(moved, name), getattr(expected, name), atol=1e-5)


@needs_usd
def test_degree_four_is_read_to_degree_three() -> None:
    loaded = read_model(scene(4))
    assert loaded.model.sh_degree == 3
    assert [each.code for each in loaded.repairs] == ["degree_dropped"]
    np.testing.assert_array_equal(loaded.model.sh[1, 0], [25, 25.25, -25])


@needs_usd
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (scene(coefficients=1), "has 1 coefficients for 2"),
        (scene(7), "read is 0 to 4"),
        (scene().replace(b"[0.5, 0.75]", b"[0.5]"), "has 1 rows, positions 2"),
        (scene().replace(b"opacities", b"opaque"), "is missing"),
        (scene(body='token visibility = "invisible"'), "holds no Gaussians"),
        (scene().replace(b"ParticleField3DGaussianSplat", b"Points"), "holds no Gaussians"),
        (scene(body="point3f[] positions.timeSamples = { 0: [(0,0,0), (1,1,1)], 1: [(1,1,1), (2,2,2)] }"), "with time"),
        (scene().replace(b'"World"', b'"World" (references = @/etc/other.usda@)'), "refers to 1 other file"),
        (b"#usda 1.0\ndef {", "cannot be read as OpenUSD"),
        (b"PXR-USDC" + bytes(200), "cannot be read as OpenUSD"),
    ],
)
def test_what_is_no_scene_of_ours_is_named(data: bytes, words: str) -> None:
    with pytest.raises((FormatError, UnsupportedFormatError), match=words):
        read_model(data)


@needs_usd
def test_an_archive_of_several_layers(tmp_path: Path) -> None:
    from pxr import UsdUtils

    (tmp_path / "splats.usda").write_bytes(scene())
    (tmp_path / "root.usda").write_text("#usda 1.0\n(subLayers = [@./splats.usda@])\n")
    UsdUtils.CreateNewUsdzPackage(str(tmp_path / "root.usda"), str(tmp_path / "all.usdz"))
    assert len(zipfile.ZipFile(tmp_path / "all.usdz").namelist()) == 2
    assert len(read_model(tmp_path / "all.usdz").model) == 2


@needs_usd
def test_a_volume_of_nurec_is_named(tmp_path: Path) -> None:
    """As 3DGRUT packs it for Omniverse."""
    with zipfile.ZipFile(tmp_path / "scene.usdz", "w") as archive:
        archive.writestr("default.usda", '#usda 1.0\ndef Volume "gauss" {}\n')
        archive.writestr("scene.nurec", b"\x1f\x8b")
    with pytest.raises(UnsupportedFormatError, match=r"NuRec: export the scene as \.ply"):
        read_model(tmp_path / "scene.usdz")


@needs_usd
@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(3, 6))])
@pytest.mark.parametrize("kind", ["usda", "usdc", "usdz"])
def test_damage_is_an_error_of_ours_or_a_model(kind: str, seed: int) -> None:
    """Flipped, overwritten with extreme counts, and cut off: what native code does then must not end this process."""
    data, rng = bytearray(encode_model(random_model(1, 40), kind)), np.random.default_rng(seed)
    at = int(rng.integers(0, len(data) - 8))
    if seed % 3 == 0:
        del data[at:]
    elif seed % 3 == 1:
        data[at : at + 8] = b"\xff\xff\xff\x7f\xff\xff\xff\x7f"
    else:
        data[at] ^= 1 << int(rng.integers(8))
    try:
        found = len(read_model(bytes(data), name=f"scene.{kind}").model)
    except FormatError as error:
        found = len(error.message)
    assert found > 0


def test_without_the_extra_it_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(module: str) -> Any:
        raise ModuleNotFoundError(name=module)

    monkeypatch.setattr("engine.extras.import_module", refuse)
    model: GaussianModel = random_model(0, 3)
    with pytest.raises(InputError, match=r"pip install 'mark3dgs\[usd\]'"):
        write_model(model, tmp_path / "scene.usdz")
    with pytest.raises(UnsupportedFormatError, match=r"OpenUSD.*mark3dgs\[usd\]"):
        read_model(scene())


@needs_usd
def test_what_is_no_gaussian_of_a_scene_is_named() -> None:
    assert read_model(scene()).repairs == ()
    other = 'def Mesh "Floor" {}\n    def Camera "Eye" {}'
    (told,) = read_model(scene(above=other, body="float[] primvars:label = [1, 2]")).repairs
    assert told.code == "extra_usd"
    assert all(name in told.text for name in ("'/World/Floor'", "'/World/Eye'", "'primvars:label'"))


@needs_usd
def test_gaussians_that_a_transform_moves_are_refused() -> None:
    moved = """double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 9: (5, 0, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]"""
    with pytest.raises(UnsupportedFormatError, match="moves with time"):
        read_model(scene(above=moved))


@needs_usd
def test_colors_of_linear_light_are_refused() -> None:
    """fvdb and 3DGRUT name the space of their colors; the usual one is no news."""
    name = 'uniform token colorSpace:name = "{}"'
    with pytest.raises(UnsupportedFormatError, match="colors are 'lin_rec709_scene', read are those of screens"):
        read_model(scene(body=name.format("lin_rec709_scene")))
    assert read_model(scene(body=name.format("srgb_rec709_display"))).repairs == ()


@needs_usd
def test_instances_are_shown_where_they_stand() -> None:
    """A reference within the file is none to another one."""
    placed = 'double3 xformOp:translate = (8, 0, 0)\n    uniform token[] xformOpOrder = ["xformOp:translate"]'
    instance = f'def Xform "Copy" (instanceable = true\n references = </World>)\n{{\n{placed}\n}}\n'
    loaded = read_model(scene() + instance.encode())
    assert loaded.model.means[:, 0].tolist() == [0, 1, 8, 9]


@needs_usd
@pytest.mark.parametrize(("purpose", "shown"), [("render", True), ("proxy", False), ("guide", False)])
def test_what_stands_in_for_a_scene_is_not_shown_with_it(purpose: str, shown: bool) -> None:
    other = scene().replace(b"#usda 1.0", b"").replace(b'"World"', b'"Other"')
    other = other.replace(b"{", b'{\n    uniform token purpose = "%s"' % purpose.encode(), 2)  # the Gaussians', too
    loaded = read_model(scene() + other)
    assert len(loaded.model) == 2 + 2 * shown
    assert [each.count for each in loaded.repairs] == [1] * (not shown)


@needs_usd
def test_map_coordinates_of_a_transform_keep_their_precision() -> None:
    far = 'double3 xformOp:translate = (512000, 5400000, 100)\n    uniform token[] xformOpOrder = ["xformOp:translate"]'
    loaded = read_model(
        scene(above=far).replace(b"(1, 1, 1), (0.5, 0.25, 2)", b"(0.01, 0.01, 0.01), (0.01, 0.01, 0.01)")
    )
    assert loaded.model.origin == (512000.0, 5400000.0, 100.0)
    assert loaded.model.means.tolist() == [[0, 0, 0], [1, 0, 0]]
    assert [each.code for each in loaded.repairs] == ["origin_moved"]


@needs_usd
def test_more_coefficients_than_the_degree_has_are_refused() -> None:
    """The first of them all would be those of the first Gaussians."""
    with pytest.raises(FormatError, match="has 8 coefficients for 2 Gaussians of degree 0"):
        read_model(scene(coefficients=8))
