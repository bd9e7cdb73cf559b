"""Slow twin of `engine.pictures.jpeg.coded_blocks._fit_tables`."""

import numpy as np

from engine.model import Float64
from engine.pictures.jpeg.config import CONFIG


def fit_tables(coefficients: Float64, tables: Float64) -> list[float]:
    """Of coefficients (K, B) and tables (Q, K): see there."""
    fits = []
    for table in tables:
        use = table >= CONFIG.least_step
        steps = np.broadcast_to(table[use][:, None], coefficients[use].shape)
        multiple = coefficients[use] / steps
        loud = np.abs(multiple) > 0.6
        if use.sum() < 6 or (loud.sum(axis=1) > 4).sum() < 3:
            fits.append(np.inf)
            continue
        off = (multiple - np.round(multiple)) * steps
        fits.append(float(np.square(off[loud]).sum() / (np.square(steps[loud]) / 12.0).sum()))
    return fits
