"""Hostile records with a correct seal: refused in words, before anything in them is used."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.errors import MalformedRecordError
from engine.flows.records.opened_record import FIRST_STRENGTH, OpenedRecord, open_record
from engine.records.file import seal
from engine.records.record import Record
from engine.records.reference import encode_reference
from engine.watermark.grain import Grain
from tests.data.records.make_golden import KEY, golden_model

COUNT, CODES = 40, 4


def plan_arrays() -> dict[str, Any]:
    """Everything that a plan may hold, for the 40 Gaussians of the golden record."""
    viewmats, lenses = np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(3), (2, 1, 1))
    lenses[:, :2, :2] *= 500.0
    return {
        "labels/0": (np.arange(COUNT) % CODES).astype(np.uint16),
        "directions/0": np.eye(3),
        "amplitudes": np.full(3 * CODES, 0.02, np.float32),
        "cameras/viewmats": viewmats,
        "cameras/intrinsics": lenses,
        "cameras/sizes": np.full((2, 2), 64, np.int32),
        "landmarks/points": np.zeros((5, 3), np.float32),
        "landmarks/descriptors": np.zeros((5, 128), np.uint8),
        "landmarks/views": np.zeros(5, np.int32),
    }


PLAN = {"message": "deadbeef", "codes": [CODES], "grain": {"center": 0.05, "scale": 0.02}}
EXTRA: dict[str, Any] = {"settings": {}}
NO = object()
"""Stands for a field that is left out."""


def opened(
    arrays: dict[str, Any] | None = None,
    plan: dict[str, Any] | None = None,
    extra: dict[str, Any] | None = None,
    version: int = 2,
) -> OpenedRecord:
    """A record with some of its fields changed, sealed by its owner, opened again."""

    def changed(start: dict[str, Any], changes: dict[str, Any] | None) -> dict[str, Any]:
        return {name: value for name, value in (start | (changes or {})).items() if value is not NO}

    record = Record.make(
        KEY,
        encode_reference(golden_model()),
        original_digest="ab" * 32,
        plan=(changed(PLAN, plan), changed(plan_arrays(), arrays)),
        extra=changed(EXTRA, extra),
    )
    record = replace(record, header=replace(record.header, format_version=version))
    return open_record(record.to_bytes(KEY), KEY)


def with_value(name: str, value: float, at: int = 3) -> dict[str, Any]:
    array = plan_arrays()[name].copy()
    array.reshape(-1)[at] = value
    return {name: array}


def test_a_sound_record_opens() -> None:
    found = opened()
    assert not found.reference.antialiased
    assert opened(plan={"antialiased": True}).reference.antialiased
    assert (found.strength, found.grain) == (1.0, Grain(0.05, 0.02))
    early = opened(plan={"grain": NO}, extra={"strength": 2.5}, version=1)
    assert early.strength == pytest.approx(2.5 / FIRST_STRENGTH)
    np.testing.assert_allclose(early.layout.amplitudes, 0.02 * FIRST_STRENGTH, rtol=1e-6)
    assert not early.grain.there
    assert len(found.cameras) == 2
    assert found.landmarks is not None
    assert opened(plan={"commitments": {"beside": "ab" * 32}}).commitments == {"beside": "ab" * 32}
    assert opened(dict.fromkeys(("landmarks/points", "landmarks/descriptors", "landmarks/views"), NO)).landmarks is None


HOSTILE: list[tuple[str, dict[str, Any]]] = [
    # A field that nobody reads is a free number to try records out with.
    ("unknown array 'nonce'", {"nonce": np.arange(8)}),
    ("unknown array 'labels/1'", {"labels/1": plan_arrays()["labels/0"]}),
    ("unknown array 'labels'", {"labels": plan_arrays()["labels/0"]}),
    ("lack the array 'amplitudes'", {"amplitudes": NO}),
    ("lack the array 'landmarks/views'", {"landmarks/views": NO}),
    ("from nan to nan", with_value("amplitudes", np.nan)),
    ("from 0.0.* to inf", with_value("amplitudes", np.inf)),
    ("from -1", with_value("amplitudes", -1.0)),
    ("to 1.0.*e\\+30", with_value("amplitudes", 1e30)),
    ("11 amplitudes for 12|11,.*12", {"amplitudes": np.full(11, 0.02, np.float32)}),
    ("float64 of shape", {"amplitudes": np.full(12, 0.02)}),
    ("shape \\(3, 4\\)", {"amplitudes": np.full((3, 4), 0.02, np.float32)}),
    ("lie outside", with_value("labels/0", 4)),
    ("41,", {"labels/0": np.zeros(41, np.uint16)}),
    ("from -1", {"labels/0": np.full(COUNT, -1, np.int32)}),
    ("to nan", with_value("directions/0", np.nan)),
    ("orthonormal", {"directions/0": np.ones((3, 3))}),
    ("orthonormal", {"directions/0": np.zeros((3, 3))}),
    ("0 rows", {"directions/0": np.zeros((0, 3)), "amplitudes": np.zeros(0, np.float32)}),
    ("to inf", with_value("cameras/viewmats", np.inf)),
    ("rigid", with_value("cameras/viewmats", 5.0, at=0)),
    ("rigid", with_value("cameras/viewmats", 5.0, at=12)),
    ("to inf", with_value("cameras/intrinsics", np.inf, at=0)),
    ("no lens", with_value("cameras/intrinsics", 0.0, at=0)),
    ("no lens", with_value("cameras/intrinsics", 0.0, at=8)),
    ("from 0", with_value("cameras/sizes", 0)),
    ("to 2147483647", with_value("cameras/sizes", 2**31 - 1)),
    ("2 expected", {"cameras/sizes": np.full((3, 2), 64, np.int32)}),
    (
        "0 rows",
        {f"cameras/{name}": plan_arrays()[f"cameras/{name}"][:0] for name in ("viewmats", "intrinsics", "sizes")},
    ),
    ("to nan", with_value("landmarks/points", np.nan)),
    ("5 expected", {"landmarks/descriptors": np.zeros((4, 128), np.uint8)}),
    ("uint16", {"landmarks/descriptors": np.zeros((5, 128), np.uint16)}),
    ("from -7", with_value("landmarks/views", -7)),
]


@pytest.mark.parametrize(("text", "arrays"), HOSTILE, ids=[f"{k}: {text}" for k, (text, _) in enumerate(HOSTILE)])
def test_arrays_are_checked_before_they_are_used(text: str, arrays: dict[str, Any]) -> None:
    with pytest.raises(MalformedRecordError, match=text):
        opened(arrays)


@pytest.mark.parametrize(
    ("text", "plan", "extra"),
    [
        ("'nonce'", {"nonce": 7}, {}),
        ("'nonce'", {}, {"nonce": 7}),
        ("lack 'message'", {"message": NO}, {}),
        ("'message'", {"message": "xy"}, {}),
        ("'message'", {"message": "ab" * 33}, {}),
        ("'message'", {"message": "DEADBEEF"}, {}),
        ("'message'", {"message": 5}, {}),
        ("'codes'", {"codes": []}, {}),
        ("'codes'", {"codes": ["4"]}, {}),
        ("'codes'", {"codes": [10**400]}, {}),
        ("'codes'", {"codes": [-4]}, {}),
        ("'codes'", {"codes": [4.0]}, {}),
        ("'codes'", {"codes": [1] * 17}, {}),
        ("'commitments'", {"commitments": {"a": "x" * 500}}, {}),
        ("'commitments'", {"commitments": {"a": 5}}, {}),
        ("'commitments'", {"commitments": "a"}, {}),
        ("'antialiased'", {"antialiased": False}, {}),
        ("'antialiased'", {"antialiased": 1}, {}),
        ("'strength'", {}, {"strength": "nan"}),
        ("'strength'", {}, {"strength": 10**400}),
        ("'strength'", {}, {"strength": 1e300}),
        ("'strength'", {}, {"strength": -1.0}),
        ("'strength'", {}, {"strength": True}),
        ("'strength'", {}, {"strength": None}),
        ("'grain'", {"grain": {"center": 0.05}}, {}),
        ("'grain'", {"grain": {"center": 0.05, "scale": 0.02, "nonce": 1.0}}, {}),
        ("'grain'", {"grain": {"center": 0.0, "scale": 0.0}}, {}),
        ("'grain'", {"grain": {"center": -0.05, "scale": 0.02}}, {}),
        ("'grain'", {"grain": {"center": 1.5, "scale": 0.02}}, {}),
        ("'grain'", {"grain": {"center": 10**400, "scale": 0.02}}, {}),
        ("'grain'", {"grain": None}, {}),
        ("not those of format 2", {}, {"strength": 2.5}),
        ("'settings'", {}, {"settings": []}),
    ],
)
def test_values_are_checked_before_they_are_used(text: str, plan: dict[str, Any], extra: dict[str, Any]) -> None:
    with pytest.raises(MalformedRecordError, match=text):
        opened(plan=plan, extra=extra)


def test_fields_are_those_of_the_format() -> None:
    """A grain in a record of the first version, or none of its strength, would be a free choice."""
    for plan, extra in (({}, {"strength": 2.5}), ({"grain": NO}, {})):
        with pytest.raises(MalformedRecordError, match="not those of format 1"):
            opened(plan=plan, extra=extra, version=1)


def test_a_small_file_does_not_become_a_large_body() -> None:
    """A hundred million bytes of nothing pack into ten thousand."""
    record = Record.make(KEY, encode_reference(golden_model()), original_digest="ab" * 32, plan=(PLAN, plan_arrays()))
    began = time.process_time()
    data = seal(record.header, bytes(100_000_000), KEY)
    assert len(data) < 100_000
    sealing = time.process_time() - began
    began = time.process_time()
    with pytest.raises(MalformedRecordError, match="times as many"):
        open_record(data, KEY)
    assert time.process_time() - began < 0.2 + sealing


def test_carriers_span_dc_or_all_that_the_reference_has() -> None:
    width = 3 * golden_model().sh.shape[1]
    assert width > 3
    wide = np.eye(3, width)
    assert opened({"directions/0": wide}).layout.width == width
    for other in (width - 3, width + 3):
        if other != 3:
            with pytest.raises(MalformedRecordError, match=f"carriers of the record span {other} numbers of {width}"):
                opened({"directions/0": np.eye(3, other)})
