from __future__ import annotations

import numpy as np
import pytest

from engine.errors import CapacityError, InputError
from engine.model import SH_C0
from engine.watermark.config import CONFIG
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.messages import derive_message, message_hex, message_signs
from engine.watermark.planning import LUMA, check_capacity, make_carriers
from engine.watermark.spreading import spread

KEY = OwnerKey(bytes(range(32)))


def small_layout(seed: int = 0, n: int = 400) -> Layout:
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    codes = (32, 16)
    labels = tuple(np.concatenate([np.arange(c), rng.integers(0, c, n - c)]).astype(np.int32) for c in codes)
    return Layout(labels, codes, (basis, np.eye(3)), rng.uniform(0.01, 0.03, sum(codes) * 3))


def test_gather_is_the_adjoint_of_displace() -> None:
    layout = small_layout()
    rng = np.random.default_rng(1)
    signed, gradient = rng.standard_normal(layout.chips), rng.standard_normal((400, 3))
    left = float((layout.displace(signed).astype(np.float64) * gradient).sum())
    right = float(signed @ layout.gather(gradient))
    assert left == pytest.approx(right, rel=1e-5)


def test_displacement_of_one_chip_moves_its_members_along_its_carrier() -> None:
    layout = small_layout()
    signed = np.zeros(layout.chips)
    signed[3 * 5 + 2] = 0.5  # stage 0, code 5, carrier 2
    moved = layout.displace(signed)
    member = layout.labels[0] == 5
    np.testing.assert_allclose(moved[member], np.tile(0.5 * layout.directions[0][2], (member.sum(), 1)), atol=1e-6)
    assert not moved[~member].any()


def test_carriers_are_orthonormal_luma_first_and_see_no_sh_rest() -> None:
    rng = np.random.default_rng(2)
    book = rng.standard_normal((64, 48)).astype(np.float32)
    usage = rng.gamma(1.0, 1.0, 64)
    carriers = make_carriers(book, usage)
    np.testing.assert_allclose(carriers.directions @ carriers.directions.T, np.eye(3), atol=1e-12)
    assert abs(carriers.directions[0] @ LUMA) > 0.8
    assert np.linalg.norm(carriers.amplitudes) == pytest.approx(1.0)
    book[:, 3:] += 10.0
    np.testing.assert_array_equal(make_carriers(book, usage).directions, carriers.directions)


def test_any_run_of_neighbours_carries_every_bit() -> None:
    spreading = spread(KEY, b"asset", (256, 100), 3, 32)
    bits = spreading.bit_of.reshape(-1, 3)
    assert (bits == bits[:, :1]).all()  # a code vector carries one bit in all its carriers
    for start in range(0, 256, 32):
        assert sorted(bits[start : start + 32, 0]) == list(range(32))
    assert len(spreading.chips) == 356 * 3
    assert abs(int(spreading.chips.sum())) < 150


def test_other_key_or_asset_gives_unrelated_chips() -> None:
    def chips(key: OwnerKey, context: bytes) -> np.ndarray:
        return spread(key, context, (4096,), 1, 32).chips.astype(int)

    base = chips(KEY, b"asset")
    np.testing.assert_array_equal(base, chips(KEY, b"asset"))
    for other in (chips(OwnerKey(bytes(range(1, 33))), b"asset"), chips(KEY, b"other")):
        assert abs(int(base @ other)) < 5 * np.sqrt(4096)


def test_signed_amplitudes_flip_with_the_message() -> None:
    layout = small_layout()
    spreading = spread(KEY, b"x", layout.codes, 3, 16)
    message = message_signs("a5c3")
    signed = layout.amplitudes * spreading.values(message)
    np.testing.assert_allclose(signed, -layout.amplitudes * spreading.values(-message))
    np.testing.assert_allclose(np.abs(signed), layout.amplitudes)


@pytest.mark.parametrize("text", ["zz", "a", "ab", "ab" * 33, ""])
def test_bad_messages_are_refused_by_name(text: str) -> None:
    with pytest.raises(InputError):
        message_signs(text)


def test_messages_round_trip_and_derive() -> None:
    assert message_hex(message_signs("0xDEADBEEF")) == "deadbeef"
    assert message_signs("8001")[[0, 1, 15]].tolist() == [1, -1, 1]
    drawn = derive_message(KEY, 64, b"asset")
    assert len(drawn) == 64
    assert message_hex(drawn) != message_hex(derive_message(KEY, 64, b"copy"))


def test_capacity_refusal_names_both_numbers() -> None:
    with pytest.raises(CapacityError, match=r"carries 23 bits.*32 were requested") as caught:
        check_capacity(32, 23)
    assert (caught.value.wanted, caught.value.capacity) == (32, 23)


def test_carriers_follow_what_the_pictures_show() -> None:
    """Code vectors that no view shows have no say; the others by how much of the views they cover."""
    rng = np.random.default_rng(5)
    book = rng.standard_normal((64, 3)).astype(np.float32)
    usage = np.where(np.arange(64) < 40, rng.gamma(1.0, 1.0, 64), 0.0)
    carriers = make_carriers(book, usage)
    np.testing.assert_allclose(carriers.directions, make_carriers(book[:40], usage[:40]).directions, atol=1e-9)
    repeated = np.repeat(book[:2], [3, 1], axis=0)
    np.testing.assert_allclose(
        make_carriers(repeated, np.ones(4)).directions,
        make_carriers(book[:2], np.array([3.0, 1.0])).directions,
        atol=1e-9,
    )
    # Singular values fall: what is shown is largest along the first carrier.
    shown = (0.5 + SH_C0 * book[:40].astype(np.float64)) @ carriers.directions.T
    energy = usage[:40] @ shown**2
    assert energy[0] > energy[1] > energy[2]


def test_carriers_have_one_sign_and_chroma_keeps_its_floor() -> None:
    gray = np.repeat(np.random.default_rng(6).uniform(0.5, 2.0, (64, 1)), 3, axis=1).astype(np.float32)
    carriers = make_carriers(gray, np.ones(64))
    np.testing.assert_allclose(carriers.directions[0], np.full(3, np.sqrt(1 / 3)), atol=1e-6)
    for direction in carriers.directions:
        assert direction[np.abs(direction).argmax()] > 0
    assert carriers.amplitudes[0] == carriers.amplitudes.max()
    relative = carriers.amplitudes / carriers.amplitudes[0] * abs(carriers.directions[0] @ LUMA)
    assert relative.min() >= CONFIG.planning.chroma_floor - 1e-9


def test_bits_are_dealt_anew_in_every_hand() -> None:
    """By the key: no two runs, stages or keys have one order."""
    bits = spread(KEY, b"asset", (128, 64), 1, 32).bit_of.reshape(-1, 32)
    other = spread(OwnerKey(bytes(range(1, 33))), b"asset", (128, 64), 1, 32).bit_of.reshape(-1, 32)
    orders = [tuple(hand) for hand in (*bits, *other)]
    assert len(set(orders)) == len(orders) == 12
    assert all(sorted(hand) == list(range(32)) for hand in orders)


def test_a_message_comes_in_whole_bytes_and_what_was_not_read_is_zero() -> None:
    for bits in (20, 8, 264):
        with pytest.raises(InputError, match="16 to 256 bits in whole bytes"):
            derive_message(KEY, bits, b"asset")
    assert message_hex(np.array([1, 1, 1, 1, 0, 0, 0, 0, -1, 0, 1, 0, -1, -1, -1, -1], np.int8)) == "f020"


def test_a_message_that_just_fits_is_taken() -> None:
    check_capacity(32, 32)


def test_carriers_over_all_coefficients_are_the_first_singular_vectors() -> None:
    """The paper's SVD; with DC alone both are the same."""
    rng = np.random.default_rng(5)
    book = rng.standard_normal((64, 12)).astype(np.float32) * np.linspace(1.5, 0.2, 12, dtype=np.float32)
    usage = rng.gamma(1.0, 1.0, 64)
    shown = SH_C0 * book.astype(np.float64)
    shown[:, :3] += 0.5
    right = np.linalg.svd(np.sqrt(usage)[:, None] * shown, full_matrices=False)[2][:3]
    carriers = make_carriers(book, usage, whole=True)
    np.testing.assert_allclose(np.abs((carriers.directions * right).sum(axis=1)), 1.0, atol=1e-9)
    assert np.linalg.norm(carriers.directions[:, 3:]) > 0.05
    floored = np.maximum(np.abs(right[:, :3] @ LUMA), CONFIG.planning.chroma_floor)
    np.testing.assert_allclose(carriers.amplitudes * np.linalg.norm(floored), floored, atol=1e-9)
    dc = make_carriers(book[:, :3], usage, whole=True)
    np.testing.assert_array_equal(dc.directions, make_carriers(book, usage).directions)


def test_a_wide_layout_displaces_all_coefficients_and_reads_dc_alone() -> None:
    layout = small_layout()
    rng = np.random.default_rng(3)
    bases = tuple(np.linalg.qr(rng.standard_normal((12, 3)))[0].T for _ in layout.codes)
    wide = Layout(layout.labels, layout.codes, bases, layout.amplitudes)
    signed, gradient = rng.standard_normal(wide.chips), rng.standard_normal((400, 12))
    moved = wide.displace(signed)
    assert (wide.width, moved.shape) == (12, (400, 12))
    assert float((moved * gradient).sum()) == pytest.approx(float(signed @ wide.gather(gradient)), rel=1e-5)
    alone = np.concatenate([gradient[:, :3], np.zeros((400, 9))], axis=1)
    np.testing.assert_allclose(wide.gather(gradient[:, :3]), wide.gather(alone), atol=1e-12)
