"""Naming the copies behind one suspect: many candidates of signs against one evidence (DESIGN 5, "copies").

Copies of one asset under one key share the reference, the code vectors and the carriers; only message and chips
differ. So a suspect is read once, and every copy is one Z more. When n copies are averaged each keeps 1/n of its
displacement, and its sisters' are noise to it: Z falls as 1/sqrt(n), not as 1/n.

The theorem of `statistics` holds for each copy by itself: an innocent one's signs are fair coins given the suspect,
whoever colluded and however, for they had no part in making it. The number of copies looked at multiplies the bound.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.model import Float64
from engine.watermark.messages import Signs
from engine.watermark.spreading import Spreading
from engine.watermark.statistics import weighted_evidence

_BATCH = 256  # copies at a time: their signs as float64 stay below 100 MB


@dataclass(frozen=True, eq=False)
class CopyMark:
    """What tells one copy from its sisters."""

    record_id: str  # of its record, hexadecimal
    copy: str  # name of the recipient
    signs: Signs  # (C,) chip times bit of the registered message: +-1


def copy_mark(record_id: str, copy: str, spreading: Spreading, message: Signs) -> CopyMark:
    """The mark of one copy, from its chips and its registered message (B,) of +-1."""
    return CopyMark(record_id, copy, spreading.signs(message))


def copies_z(y: Float64, w: Float64, marks: Sequence[CopyMark]) -> Float64:
    """(N,) claim statistic Z of each copy, as `statistics.claim_z` gives it one by one.

    y and w (C,) are one reading of the suspect, blind to all chips; finite, weights >= 0. ValueError if a mark has
    other than C signs.
    """
    c = weighted_evidence(y, w)
    norm = math.sqrt(float(c @ c))
    z = np.zeros(len(marks))
    for start in range(0, len(marks), _BATCH):
        signs = np.stack([mark.signs for mark in marks[start : start + _BATCH]])
        if signs.shape[1] != len(c):
            raise ValueError(f"a copy has {signs.shape[1]} signs, the evidence {len(c)} chips")
        # One row, one sum: the answer for a copy does not depend on which others are asked about.
        z[start : start + len(signs)] = np.einsum("nc,c->n", signs.astype(np.float64), c)
    return z / norm if norm > 0 else z
