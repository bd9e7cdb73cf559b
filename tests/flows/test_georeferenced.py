"""A scene in map coordinates is marked, found and seen as the same scene at the origin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model, write_model
from engine.raster import render
from engine.watermark.keys import OwnerKey
from tests.scenes import sparse_plant

KEY = OwnerKey(bytes(range(32)))
UTM = (448_123.0, 5_412_345.0, 312.0)


def test_in_map_coordinates(tmp_path: Path) -> None:
    plain = read_model(sparse_plant("ply")).model
    write_model(replace(plain, origin=UTM), tmp_path / "utm.ply")
    loaded = read_model(tmp_path / "utm.ply")
    cameras = make_rig(plain, 9, 320, 240)
    on_map = [camera.relative_to(np.negative(UTM)) for camera in cameras]
    config = profile("fast", landmark_views=0)
    made = embed(loaded.model, KEY, original_sha256=loaded.sha256, config=config, cameras=on_map)
    write_model(made.model, tmp_path / "marked.ply")
    suspect = read_model(tmp_path / "marked.ply").model
    assert np.abs(suspect.means).max() < 1e3
    opened = open_record(made.record.to_bytes(KEY), KEY)
    found = verify_model(suspect, opened)
    assert found.claim.verdict == "marked"
    picture = render(suspect, cameras[4].relative_to(np.subtract(UTM, suspect.origin)))
    seen = verify_images([picture], opened, cameras=[on_map[4]])
    assert seen.claim.verdict == "marked"
