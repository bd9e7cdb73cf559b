"""The .splat format, which has no magic and no header."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from engine.errors import FormatError
from engine.formats import encode_model, read_model
from engine.formats.image_files import is_picture
from engine.formats.kinds.splat import RECORD, looks_like_splat, read_splat
from engine.model import SH_C0
from engine.scenes.scene_files import read_scene
from tests.formats.models import DATA, random_model

PLANT = DATA / "plant.splat"


def test_round_trip_within_half_a_step() -> None:
    model = random_model(0, 5000)
    loaded = read_model(encode_model(model, "splat"))
    assert loaded.format == "splat"
    back = loaded.model
    np.testing.assert_array_equal(back.means, model.means)
    np.testing.assert_allclose(back.log_scales, model.log_scales, atol=1e-6)
    assert np.abs(back.opacities - model.opacities).max() <= 0.5 / 255 + 1e-6
    colors = np.clip(0.5 + SH_C0 * model.sh[:, 0], 0, 1)
    assert np.abs(0.5 + SH_C0 * back.sh[:, 0] - colors).max() <= 0.5 / 255 + 1e-6
    dots = np.abs(np.einsum("nq,nq->n", back.quats.astype(np.float64), model.quats))
    assert np.degrees(2 * np.arccos(dots.min())) < 1.0


def test_a_real_scene_is_written_back_byte_for_byte_but_for_quaternions() -> None:
    """Other writers do not scale quaternions to the same length before rounding."""
    loaded = read_model(PLANT)
    theirs = np.frombuffer(PLANT.read_bytes(), RECORD)
    ours = np.frombuffer(encode_model(loaded.model, "splat"), RECORD)
    np.testing.assert_array_equal(ours["means"], theirs["means"])
    np.testing.assert_array_equal(ours["rgba"], theirs["rgba"])
    np.testing.assert_allclose(ours["scales"], theirs["scales"], rtol=1e-5)
    assert np.abs(ours["quats"].astype(int) - theirs["quats"]).max() <= 2
    assert [(repair.code, repair.count) for repair in loaded.repairs] == [("opacities_infinite", 199)]
    assert len(loaded.model) == 113648


def test_dirty_rows() -> None:
    records = np.frombuffer(encode_model(random_model(0, 10), "splat"), RECORD).copy()
    records["scales"][1] = 0
    records["scales"][2, 1] = -1
    records["means"][3, 0] = np.nan
    records["quats"][4] = 128
    loaded = read_model(records.tobytes())
    counts = {repair.code: repair.count for repair in loaded.repairs}
    assert counts == {"rows_dropped": 2, "scales_clamped": 1, "quaternions_zero": 1}
    np.testing.assert_array_equal(loaded.model.quats[2], [1, 0, 0, 0])


@pytest.mark.parametrize("change", [-1, 1, 31])
def test_a_length_that_is_no_multiple_of_32_is_refused(change: int) -> None:
    data = encode_model(random_model(0, 10), "splat")
    data = data[:change] if change < 0 else data + bytes(change)
    for read in (read_model, lambda data: read_splat(data, file="x")):
        with pytest.raises(FormatError, match=f"{len(data)} bytes are no multiple of 32 bytes: cut off"):
            read(data)


def test_what_does_not_look_like_gaussians() -> None:
    noise = np.random.default_rng(0).integers(0, 256, 32 * 5000, dtype=np.uint8).tobytes()
    text = b"The quick brown fox jumps over.\n" * 100
    for data in (noise, text, bytes(3200), b"\xff" * 3200, b""):
        assert not looks_like_splat(data)
    assert looks_like_splat(PLANT.read_bytes())


HEADS = (b"PK\3\4", b"PK..", b"\x1f\x8b\x08\0", b"NGSP", b"ply\n", b"glTF", b"{..:", b"[..:", b"BM..", b"\xff\xd8\xff.")


@pytest.mark.parametrize("head", HEADS)
def test_the_first_number_may_be_any_bytes(head: bytes, tmp_path: Path) -> None:
    """By chance, or to prevent the check of a copy that every viewer shows."""
    path = tmp_path / "copy.splat"
    path.write_bytes(head + encode_model(random_model(0, 100), "splat")[4:])
    assert not is_picture(path)
    loaded = read_scene(path)
    assert (loaded.format, len(loaded.model)) == ("splat", 100)


def test_two_models_in_one_file_are_refused() -> None:
    """A viewer that goes by the name shows the rows, one that goes by the first bytes the archive."""
    file = io.BytesIO()
    sog = encode_model(random_model(1, 50), "sog")
    with zipfile.ZipFile(io.BytesIO(sog)) as archive, zipfile.ZipFile(file, "w") as both:
        both.writestr("ab", encode_model(random_model(0, 5000), "splat"))  # behind 30 + 2 bytes: whole rows
        for name in archive.namelist():
            both.writestr(name, archive.read(name))
    data = file.getvalue()[:-2]  # what follows is the length of a comment, and that
    fill = 64 - (len(data) + 2) % 32
    assert read_model(data + bytes(2)).format == "sog"
    with pytest.raises(FormatError, match="two models at once"):
        read_model(data + fill.to_bytes(2, "little") + bytes(fill))


def test_a_row_that_is_no_gaussian_is_told() -> None:
    """Bytes that a program put before the rows are a Gaussian to every reader; its rotation shows it."""
    data = encode_model(random_model(0, 300), "splat")
    assert read_model(data).repairs == ()
    (told,) = read_model(b"HEAD" * 8 + data).repairs
    assert (told.code, told.count) == ("quaternions_normalized", 1)
    assert "row 0" in told.text
