from __future__ import annotations

import pytest
import scipy.special

from engine.numerics.chi_square import chi_square_beyond


@pytest.mark.parametrize("freedom", [1, 2, 3, 9, 10, 13, 16, 60])
@pytest.mark.parametrize("share", [1e-9, 1e-3, 0.5, 0.9, 0.999])
def test_it_is_scipys(freedom: int, share: float) -> None:
    assert chi_square_beyond(freedom, share) == pytest.approx(float(scipy.special.chdtri(freedom, share)), rel=1e-12)
