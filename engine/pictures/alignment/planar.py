"""Bring a suspect picture into the frame of a reference render: rotated, scaled, cropped (DESIGN 4.8).

1. Hypotheses: the picture as it is, the whole picture at another size, SIFT + RANSAC.
2. Robust Gauss-Newton on brightness, coarse to fine, with gain and offset, to a few hundredths of a pixel.
   The gradients are those of the noise-free render, so noise in the picture does not bias the fit.
3. A homography in place of the similarity only where it fits clearly better.
4. The picture resampled into the reference's pixels, and the mask of pixels that carry evidence.

Nothing here sees a key or a chip.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.model import Bool, Float32, Float64
from engine.numerics.resampling import map_points, smooth, warp
from engine.pictures.alignment.brightness_fit import Fit, fit_warp, still_rms
from engine.pictures.alignment.config import CONFIG
from engine.pictures.alignment.tone_and_light import predict_brightness
from engine.pictures.landmarks.keypoints import detect_keypoints, luma, match_within

_CONFIG = CONFIG.planar


@dataclass(frozen=True, eq=False)
class Alignment:
    """A suspect picture in the reference's frame."""

    matrix: Float64  # (3, 3) homography from reference pixel to suspect pixel coordinates
    warped: Float32  # (H, W, 3) the suspect resampled into the reference's pixels, 0 outside
    mask: Bool  # (H, W) pixels that carry evidence: inside the suspect, not painted over or black from a rotation
    inliers: int  # brightness samples that agree with the fit
    rms: float  # robust residual of brightness after gain and offset, image units
    correlation: float  # of both images' brightness on the pixels fitted, -1..1
    mirrored: bool  # the suspect is a mirror image: the matrix turns it over, or that was done before
    suspect: Float32  # (h, w, 3) what the matrix leads to: the suspect, turned over where that was done before

    @property
    def still(self) -> bool:
        """Whether the suspect lies on the reference pixel on pixel, and was not resampled."""
        return self.warped is self.suspect


def align_image(reference_image: Float32, suspect_image: Float32) -> Alignment | None:
    """Find the motion that lays the suspect, (h, w, 3) of any size, over the render (H, W, 3) of the unmarked
    reference, both 0..1.

    None when nothing fits. InputError if either is not a finite (H, W, 3) image.
    """
    reference, suspect = (_checked(image) for image in (reference_image, suspect_image))
    gray, suspect_gray = luma(reference), luma(suspect)
    best: Fit | None = None
    for matrix in _hypotheses(gray, suspect_gray):
        coarse = fit_warp(gray, suspect_gray, matrix, levels=(8, 4), homography=False)
        if coarse is not None and (best is None or coarse.correlation > best.correlation):
            best = coarse
        if best is not None and best.correlation > _CONFIG.sure_correlation:
            break
    if best is None or best.correlation < _CONFIG.least_correlation:
        return None
    fit = fit_warp(gray, suspect_gray, best.matrix, levels=(4, 2, 1), homography=False) or best
    return _laid_over(reference, suspect, fit)


def _laid_over(reference: Float32, suspect: Float32, fit: Fit) -> Alignment:
    """The suspect in the reference's pixels by a fit, bent where that fits better."""
    gray, suspect_gray = luma(reference), luma(suspect)
    bent = fit_warp(gray, suspect_gray, fit.matrix, levels=(2, 1), homography=True)
    if bent is not None and bent.rms < _CONFIG.perspective_gain * fit.rms:
        fit = bent
    still = gray.shape == suspect_gray.shape and _is_still(gray, suspect_gray, fit)
    return _resampled(reference, suspect, fit, np.eye(3) if still else fit.matrix)


def _resampled(reference: Float32, suspect: Float32, fit: Fit, matrix: Float64) -> Alignment:
    gray = luma(reference)
    warped, inside = _resample(suspect, matrix, *gray.shape)
    mask = _evidence_mask(gray, luma(warped), inside, fit)
    mirrored = bool(np.linalg.det(matrix[:2, :2]) < 0)
    return Alignment(matrix, warped, mask, fit.inliers, fit.rms, fit.correlation, mirrored, suspect)


def align_near(reference_image: Float32, suspect_image: Float32) -> Alignment | None:
    """As `align_image` of a suspect that lies over the render within a pixel or so: no hypotheses are sought."""
    reference, suspect = (_checked(image) for image in (reference_image, suspect_image))
    fit = fit_warp(luma(reference), luma(suspect), np.eye(3), levels=(2, 1), homography=False)
    return None if fit is None or fit.correlation < _CONFIG.least_correlation else _laid_over(reference, suspect, fit)


def align_upright(reference_image: Float32, suspect_image: Float32) -> tuple[Float64, Alignment] | None:
    """The similarity (3, 3) by which a suspect (H, W, 3) is off the render, within a pixel or so, and its alignment as
    it lies, which leaves that out; None as in `align_image`.

    InputError if their shapes differ.
    """
    reference, suspect = (_checked(image) for image in (reference_image, suspect_image))
    if reference.shape != suspect.shape:
        raise InputError(f"a picture of shape {suspect.shape} does not lie on a render of shape {reference.shape}")
    fit = fit_warp(luma(reference), luma(suspect), np.eye(3), levels=(2, 1), homography=False)
    if fit is None or fit.correlation < _CONFIG.least_correlation:
        return None
    return fit.matrix, _resampled(reference, suspect, fit, np.eye(3))


def near_motions(matrix: Float64, shape: tuple[int, ...]) -> list[Float64]:
    """Simpler motions (3, 3) near one of a render of this shape: the similarity, and whole pixels where it is nearly a
    shift by these."""
    height, width = shape[:2]
    corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
    mapped = map_points(matrix, corners)
    x, y = (corners - corners.mean(axis=0)).T
    u, v = (mapped - mapped.mean(axis=0)).T
    size = float(x @ x + y @ y)
    a, b = float(x @ u + y @ v) / size, float(x @ v - y @ u) / size
    similarity = np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, 1.0]])
    similarity[:2, 2] = mapped.mean(axis=0) - similarity[:2, :2] @ corners.mean(axis=0)
    whole = np.eye(3)
    whole[:2, 2] = np.round((mapped - corners).mean(axis=0))
    nearly = np.abs(map_points(whole, corners) - map_points(similarity, corners)).max() < _CONFIG.whole_pixels
    return [whole, similarity] if nearly else [similarity]


def align_either_hand(reference_image: Float32, suspect_image: Float32) -> Alignment | None:
    """As `align_image`; where that does not fit well, the picture turned over left to right and upside down is tried,
    too, and the better fit answers."""
    best = align_image(reference_image, suspect_image)
    if best is not None and best.correlation > _CONFIG.well_correlation:
        return best
    for axis in (1, 0):
        other = align_image(reference_image, np.flip(suspect_image, axis))
        if other is not None and (best is None or other.correlation > best.correlation):
            best = replace(other, mirrored=not other.mirrored)
    return best


def _checked(image: Float32) -> Float32:
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape) < 1:
        raise InputError(f"expected an image (H, W, 3), got shape {image.shape}")
    image = np.ascontiguousarray(image, dtype=np.float32)
    if not np.isfinite(image).all():
        raise InputError("the image holds values that are not finite")
    return np.clip(image, 0.0, 1.0)


def _hypotheses(gray: Float32, suspect: Float32) -> Iterator[Float64]:
    """Motions to try, cheapest first."""
    sy, sx = suspect.shape[0] / gray.shape[0], suspect.shape[1] / gray.shape[1]
    if abs(sx / sy - 1.0) < 0.02:
        yield np.diag([sx, sy, 1.0])
    yield from _sift_hypotheses(gray, suspect)
    if abs(sx / sy - 1.0) >= 0.02:  # squeezed, or a crop without a single good keypoint
        yield np.diag([sx, sy, 1.0])


def _sift_hypotheses(gray: Float32, suspect: Float32) -> Iterator[Float64]:
    import cv2

    a, b = detect_keypoints(gray, _CONFIG.keypoints), detect_keypoints(suspect, _CONFIG.keypoints)
    from_suspect, to_reference = match_within(b.descriptors, a.descriptors, _CONFIG.ratio)
    if len(from_suspect) < _CONFIG.least_matches:
        return
    source, target = a.points[to_reference], b.points[from_suspect]
    cv2.setRNGSeed(0)
    similarity, inliers = cv2.estimateAffinePartial2D(
        source, target, method=cv2.RANSAC, ransacReprojThreshold=_CONFIG.ransac_pixels, maxIters=2000, confidence=0.999
    )
    agreed = 0
    if similarity is not None and inliers is not None and inliers.sum() >= _CONFIG.least_matches:
        agreed = int(inliers.sum())
        yield np.vstack([similarity, [0.0, 0.0, 1.0]])
    bent, inliers = cv2.findHomography(source, target, cv2.RANSAC, _CONFIG.ransac_pixels, maxIters=2000)
    # Eight numbers explain more than four by themselves; only a clear majority counts.
    if bent is not None and inliers is not None and inliers.sum() > 1.3 * agreed + _CONFIG.least_matches:
        yield np.asarray(bent, dtype=np.float64)


def _is_still(gray: Float32, suspect: Float32, fit: Fit) -> bool:
    largest = _largest_motion(fit.matrix, *gray.shape)
    if largest < _CONFIG.snap_pixels:
        return True
    return largest < _CONFIG.snap_far and fit.rms > _CONFIG.perspective_gain * still_rms(gray, suspect, fit)


def _largest_motion(matrix: Float64, height: int, width: int) -> float:
    corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
    return float(np.abs(map_points(matrix, corners) - corners).max())


def _resample(suspect: Float32, matrix: Float64, height: int, width: int) -> tuple[Float32, Bool]:
    if suspect.shape[:2] == (height, width) and np.array_equal(matrix, np.eye(3)):
        return suspect, np.ones((height, width), dtype=np.bool_)
    scale = float(np.sqrt(abs(np.linalg.det(matrix[:2, :2]))))
    # Where several suspect pixels fall into one of the reference, average them first.
    prefiltered = smooth(suspect, 0.5 * np.sqrt(max(scale**2 - 1.0, 0.0)))
    return warp(prefiltered, matrix, height, width)


def _evidence_mask(gray: Float32, warped: Float32, inside: Bool, fit: Fit) -> Bool:
    """Inside the suspect, and not where a whole neighbourhood contradicts the reference (fill, captions)."""
    import cv2

    wrong = _contradicted(np.clip(fit.gain * gray + fit.offset, 0.0, 1.0), warped, inside)
    if np.mean(wrong) > _CONFIG.suspicious:  # captions, or a tone curve or light that gain and offset do not describe
        again = _contradicted(predict_brightness(gray, warped, inside), warped, inside)
        wrong = again if again.sum() < wrong.sum() else wrong
    bad = (wrong | ~inside).astype(np.uint8)
    size = 2 * _CONFIG.margin + 1
    grown = cv2.dilate(bad, np.ones((size, size), dtype=np.uint8), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(grown == 0)


def _contradicted(expected: Float32, warped: Float32, inside: Bool) -> Bool:
    difference = np.where(inside, np.abs(warped - expected), 0.0)
    local = smooth(difference.astype(np.float32), 4.0)
    typical = float(np.median(local[inside])) if inside.any() else 0.0
    return np.asarray(local > max(0.06, 5.0 * typical))
