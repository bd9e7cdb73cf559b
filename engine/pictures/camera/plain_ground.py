"""The part of a picture that shows an object on a plain ground.

Outlines are sought in a picture of 96 pixels, and details compared in one of 320: an asset that takes up a third of a
portrait screen is too small for both.

Nothing here sees a key or a chip.
"""

import numpy as np

from engine.model import Float32
from engine.pictures.camera.config import CONFIG

__all__ = ["find_subject"]

_CONFIG = CONFIG.ground


def find_subject(image: Float32) -> tuple[slice, slice] | None:
    """Rows and columns around the middle of a picture (H, W, 3), 0..1, that hold all it shows on a plain ground, and a
    margin; None where the ground is not plain, or that is most of the picture."""
    import cv2

    height, width = image.shape[:2]
    factor = min(1.0, _CONFIG.side / max(height, width))
    shape = max(8, round(width * factor)), max(8, round(height * factor))
    small = cv2.resize(image, shape, interpolation=cv2.INTER_AREA)
    border = np.concatenate([small[0], small[-1], small[1:-1, 0], small[1:-1, -1]])
    ground = np.median(border, axis=0)
    if (np.abs(border - ground).max(axis=1) < _CONFIG.plain).mean() < _CONFIG.least_border:
        return None
    there = (np.abs(small - ground).max(axis=2) > _CONFIG.other).astype(np.uint8)
    joined = cv2.dilate(there, np.ones((2 * _CONFIG.joined + 1,) * 2, dtype=np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(joined)
    parts = stats[1:]  # the first is the ground
    if not len(parts):
        return None
    areas = parts[:, cv2.CC_STAT_AREA]
    parts = parts[areas >= _CONFIG.least_part * areas.max()]
    low = parts[:, [cv2.CC_STAT_TOP, cv2.CC_STAT_LEFT]].min(axis=0)
    sizes = parts[:, [cv2.CC_STAT_HEIGHT, cv2.CC_STAT_WIDTH]]
    high = (parts[:, [cv2.CC_STAT_TOP, cv2.CC_STAT_LEFT]] + sizes).max(axis=0)
    margin = _CONFIG.margin * float((high - low).max())
    center = 0.5 * np.array(small.shape[:2])
    # As much on either side of the middle, so that the camera of this part looks at its middle, too.
    half = np.minimum(np.maximum(center - low, high - center) + margin, center) / center
    rows, columns = np.ceil(0.5 * half * (height, width)).astype(int).tolist()
    if 2 * max(rows, columns) > _CONFIG.most * max(height, width) or 2 * min(rows, columns) < CONFIG.least_side:
        return None
    middle = height // 2, width // 2
    return slice(middle[0] - rows, height - middle[0] + rows), slice(middle[1] - columns, width - middle[1] + columns)
