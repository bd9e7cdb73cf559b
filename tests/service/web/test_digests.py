"""The page announces the digest of a file before it sends the file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tests.service.web.journey import LONG, embed, make_key

if TYPE_CHECKING:
    from playwright.sync_api import Page

SLICE = 1 << 22
LENGTHS = (0, 1, 55, 56, 63, 64, 65, 119, 120, SLICE - 1, SLICE, SLICE + 70)
DIGEST = """async (length) => {
  const { sha256, bySlices } = await import("/static/js/sha256.js");
  const bytes = Uint8Array.from({ length }, (_, at) => (at * 31 + (at >> 8)) & 255);
  const given = [new Blob([bytes]), new AbortController().signal, () => {}];
  return [await sha256(...given), await bySlices(...given)];
}"""


def test_digests_are_sha256(page: Page) -> None:
    places = np.arange(max(LENGTHS))
    data = ((places * 31 + (places >> 8)) & 255).astype(np.uint8).tobytes()
    for length in LENGTHS:
        assert page.evaluate(DIGEST, length) == [hashlib.sha256(data[:length]).hexdigest()] * 2, length


def test_bytes_that_changed_on_the_way_are_refused(page: Page, tmp_path: Path) -> None:
    """The announced digest and the bytes differ, so there is no upload."""
    path = tmp_path / "a.splat"
    path.write_bytes(b"x" * 1024)
    make_key(page, "Changed")
    page.route("**/v1/uploads/*", lambda route: route.continue_(post_data=b"y" * 1024))
    embed(page, path, "Changed")
    box = page.get_by_role("alert")
    box.wait_for(timeout=LONG)
    assert hashlib.sha256(b"x" * 1024).hexdigest() in box.inner_text()
