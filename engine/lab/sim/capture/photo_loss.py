"""How far a render is from a photo, with the gradient: (1 - w) L1 + w (1 - SSIM) (Kerbl et al. 2023, equation 7).

With m_x, m_y the means of a window (k its weights), q = E[x^2 + y^2] and c = E[xy], SSIM is a function of m_x, m_y,
q and c, so dSSIM/dx(p) = sum over windows of k (dSSIM/dm_x + 2 x(p) dSSIM/dq + y(p) dSSIM/dc): four filters forward,
three back. Rows of an image hold width times 3 numbers, so that a tap to the right is three numbers away and every
loop runs over contiguous memory.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np

from engine.errors import InputError
from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Float32
from engine.numerics.image_metrics import SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_SIGMA

_TAPS = 2 * SSIM_RADIUS + 1
_HALF = np.float32(0.5)
_C1, _C2 = np.float32(SSIM_C1), np.float32(SSIM_C2)


def photo_loss(image: Float32, photo: Float32, ssim_weight: float = 0.2) -> tuple[float, Float32]:
    """Loss of a render against a photo, and its gradient with respect to the render.

    Both are (H, W, 3) of nominal range 0 to 1, at least 11 by 11 pixels unless w = `ssim_weight` is 0. SSIM is
    `engine.numerics.image_metrics.ssim`: the mean over all windows that lie inside the image. Nothing is clipped here:
    a render above 1 is pulled back. The same bits whatever the number of threads.
    """
    if image.shape != photo.shape or image.ndim != 3:
        raise InputError(f"render and photo must both be (H, W, C), got {image.shape} and {photo.shape}")
    if not 0.0 <= ssim_weight <= 1.0:
        raise InputError(f"ssim_weight is {ssim_weight}, expected 0 to 1")
    height, width, channels = image.shape
    if ssim_weight > 0.0 and min(height, width) < _TAPS:
        raise InputError(f"SSIM needs images of at least {_TAPS}x{_TAPS} pixels, got {width}x{height}")
    x = np.ascontiguousarray(image, dtype=np.float32).reshape(height, width * channels)
    y = np.ascontiguousarray(photo, dtype=np.float32).reshape(height, width * channels)
    gradient = np.empty_like(x)
    sums = np.zeros((height, 2))
    offsets = np.arange(_TAPS) - SSIM_RADIUS
    window = np.exp(-(offsets**2) / (2.0 * SSIM_SIGMA**2))
    weights = (window / window.sum()).astype(np.float32)
    windows = max(0, height - _TAPS + 1), max(0, width - _TAPS + 1) * channels
    if ssim_weight > 0.0:
        across = np.empty((height, 4, windows[1]), dtype=np.float32)
        slopes = np.empty((windows[0], 3, windows[1]), dtype=np.float32)
        _filter_across(x, y, weights, channels, across)
        _compare_windows(across, weights, slopes, sums)
    else:
        slopes = np.empty((0, 3, 0), dtype=np.float32)
    per_window = ssim_weight / max(windows[0] * windows[1], 1)
    per_pixel = np.float32((1.0 - ssim_weight) / x.size)
    _pull_back(x, y, weights, channels, slopes, per_pixel, np.float32(per_window), gradient, sums)
    similarity, difference = sums[:, 0].sum(), sums[:, 1].sum()
    loss = (1.0 - ssim_weight) * difference / x.size + ssim_weight - per_window * similarity
    return float(loss), gradient.reshape(image.shape)


@inlined
def _add(total, weight, values, start):
    """total += weight * values from `start` on."""
    for j in range(total.shape[0]):
        total[j] += weight * values[start + j]


@parallel_kernel(allocates=True)
def _filter_across(x, y, weights, channels, across, call):
    """Horizontal window of x, y, x^2 + y^2 and xy, about mid-grey: float32 would lose digits in bright flats."""
    for row in share_of(x.shape[0], call):
        own = across[row]
        own[:] = np.float32(0.0)
        u, v = x[row] - _HALF, y[row] - _HALF
        squares, product = u * u + v * v, u * v
        for tap in range(weights.shape[0]):
            _add(own[0], weights[tap], u, tap * channels)
            _add(own[1], weights[tap], v, tap * channels)
            _add(own[2], weights[tap], squares, tap * channels)
            _add(own[3], weights[tap], product, tap * channels)


@parallel_kernel(allocates=True)
def _compare_windows(across, weights, slopes, sums, call):
    """Vertical window; SSIM of each row of windows summed up, and its slopes by m_x, q and c."""
    one, two = np.float32(1.0), np.float32(2.0)
    for row in share_of(slopes.shape[0], call):
        means = np.zeros((4, across.shape[2]), dtype=np.float32)
        for tap in range(weights.shape[0]):
            for k in range(4):
                _add(means[k], weights[tap], across[row + tap, k], 0)
        total = 0.0
        for j in range(across.shape[2]):
            mx, my, square, cross = means[0, j], means[1, j], means[2, j], means[3, j]
            product, powers = mx * my, mx * mx + my * my
            variances = square - powers + _C2
            structure = (two * (cross - product) + _C2) / variances
            # (m_x + 1/2)(m_y + 1/2) = m_x m_y + (m_x + m_y)/2 + 1/4: means about black, where luminance is defined.
            lower = powers + mx + my + _HALF + _C1
            luminance = (two * product + mx + my + _HALF + _C1) / lower
            total += structure * luminance
            by_cross = two * luminance / variances
            by_square = -_HALF * by_cross * structure
            slopes[row, 0, j] = (
                structure / lower * (two * my + one - (two * mx + one) * luminance)
                - by_cross * my
                - two * by_square * mx
            )
            slopes[row, 1, j] = by_square
            slopes[row, 2, j] = by_cross
        sums[row, 0] = total


@parallel_kernel(allocates=True)
def _pull_back(x, y, weights, channels, slopes, per_pixel, per_window, gradient, sums, call):
    """The windows' slopes back to the pixels, and the slope of L1; |x - y| of each row summed up."""
    taps, rows, length = weights.shape[0], slopes.shape[0], slopes.shape[2]
    two, zero = np.float32(2.0), np.float32(0.0)
    for row in share_of(x.shape[0], call):
        down = np.zeros((3, length), dtype=np.float32)
        back = np.zeros((3, x.shape[1]), dtype=np.float32)
        for tap in range(taps):
            if 0 <= row - tap < rows:
                for k in range(3):
                    _add(down[k], weights[tap], slopes[row - tap, k], 0)
        for tap in range(taps if length > 0 else 0):
            for k in range(3):
                _add(back[k, tap * channels : tap * channels + length], weights[tap], down[k], 0)
        total = 0.0
        for j in range(x.shape[1]):
            difference = x[row, j] - y[row, j]
            total += abs(difference)
            sign = per_pixel if difference > zero else (-per_pixel if difference < zero else zero)
            u, v = x[row, j] - _HALF, y[row, j] - _HALF
            gradient[row, j] = sign - per_window * (back[0, j] + two * u * back[1, j] + v * back[2, j])
        sums[row, 1] = total
