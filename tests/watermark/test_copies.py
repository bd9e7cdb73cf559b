"""Many copies read at once are what each would have read alone."""

from __future__ import annotations

import numpy as np
import pytest

from engine.watermark.copies import copies_z
from engine.watermark.keys import OwnerKey
from engine.watermark.spreading import spread
from engine.watermark.statistics import claim_z


def test_each_copy_gets_the_statistic_of_a_claim() -> None:
    rng = np.random.default_rng(0)
    y, w = rng.standard_normal(3 * 400), rng.uniform(0.1, 3.0, 3 * 400)
    key = OwnerKey(bytes(range(32)))
    messages = rng.choice([-1, 1], (300, 16)).astype(np.int8)
    copies = [(spread(key, k.to_bytes(2, "big"), (400,), 3, 16), message) for k, message in enumerate(messages)]
    signs = [spreading.signs(message) for spreading, message in copies]
    found = copies_z(y, w, iter(signs))
    alone = [claim_z(y, w, spreading.bit_of, spreading.chips, message) for spreading, message in copies]
    np.testing.assert_allclose(found, alone, rtol=1e-9, atol=1e-12)
    assert not copies_z(0 * y, w, signs[:3]).any()
    with pytest.raises(ValueError, match="1200 signs, the evidence 6"):
        copies_z(y[:6], w[:6], signs)
