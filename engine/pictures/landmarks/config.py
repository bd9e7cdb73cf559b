"""Tuned constants of keypoints, landmarks and their matches, a frozen config (DESIGN 4.8)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LandmarksConfig:
    """Detection, matching, and the bank of rendered landmarks."""

    # Blur before detection, pixels per unit of noise: noise of 0.1 then falls below SIFT's contrast limit
    noise_to_blur: float = 20.0
    largest_blur: float = 2.0  # of it, pixels
    chunk: int = 256  # keypoints matched at a time: 256 rows of 20,000 distances are 20 MB
    most_unlike: float = 0.55 * 512.0  # largest distance of descriptors (length 512) of a landmark and what lies there
    per_view: int = 450  # landmarks of one view at most: 48 views of 144 bytes each make 3.1 MB
    detected: int = 1350  # keypoints detected in a view: more than needed, since edges of depth and haze are left out
    least_alpha: float = 0.7  # opacity from which a pixel shows a surface, and its depth is that surface's
    depth_edge: float = 0.05  # largest relative spread of depth in the 5 x 5 pixels around a landmark
    ahead: int = 2  # pictures drawn before they are searched: 6 MB each
    margin: int = 8  # kept around what is visible when a render is cut before detection, pixels


CONFIG = LandmarksConfig()
