"""Naming the copies behind one suspect: many candidates of signs against what it says (DESIGN 5, "copies").

Copies of one asset under one key share the reference; message, chips and cells differ. So a suspect is registered once,
its grain is read once, and every copy is its own cells and one Z more. When n copies are averaged each keeps 1/n of
its displacement, and its sisters' are noise to it: Z falls as 1/sqrt(n), not as 1/n. Rules that pick what few copies
have turn Z round; so both signs are asked, and counted.

The theorem of `statistics` holds for each copy by itself: an innocent one's signs are fair coins given the suspect,
whoever colluded and however, for they had no part in making it. The number of copies looked at multiplies the bound.
"""

import math
from collections.abc import Iterable

import numpy as np

from engine.model import Float64
from engine.watermark.messages import Signs
from engine.watermark.statistics import weighted_evidence


def copies_z(y: Float64, w: Float64, copies: Iterable[Signs]) -> Float64:
    """(N,) claim statistic Z of each copy, as `statistics.claim_z` gives it one by one.

    y and w (C,) are one reading of the suspect, blind to all chips; finite, weights >= 0. `copies` gives the signs (C,)
    of each, chip times bit of the registered message; one at a time is kept. ValueError if one has other than C signs.
    """
    c = weighted_evidence(y, w)
    norm = math.sqrt(float(c @ c))
    z = []
    for signs in copies:
        if len(signs) != len(c):
            raise ValueError(f"a copy has {len(signs)} signs, the evidence {len(c)} chips")
        z.append(float(c @ signs.astype(np.float64)) / norm if norm > 0 else 0.0)
    return np.array(z)
