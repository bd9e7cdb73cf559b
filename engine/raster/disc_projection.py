"""Pass 1 for 2DGS: discs to the image plane, where a ray meets a disc exactly in perspective.

Huang et al. 2024, "2D Gaussian Splatting for Geometrically Accurate Radiance Fields". With P (2, 2) the pixels
per standard deviation at the centre and k (2,) the relative change of depth per standard deviation, the plane's
homography solves in closed form: a pixel at d = (dx, dy) from the projected centre looks at the disc's point

    s = P^-1 d / g,  g = 1 - k . P^-1 d,  at depth z / g

(their equations 9 and 10; Sherman-Morrison instead of two homogeneous planes). g <= 0 lies behind the camera. The
larger of exp(-|s|^2 / 2) and the screen-space low pass exp(-|d|^2) counts (their equation 11, sigma sqrt(2) / 2 px).

|s| does not change when the disc's axes are turned within its plane, so P is taken as a lower triangle. A disc
is `RECORD` floats:

    u, v        centre, pixels
    i, m, j     p = P^-1 d: p0 = i dx, p1 = m dx + j dy
    k0, k1      g = 1 - k0 p0 - k1 p1
    l           log2 of the opacity

The later passes find their pixels by an ellipse, `records` as `projection.project` writes them. It covers the
projected disc and the low pass. In the coordinates p, {|s|^2 <= r^2} is the conic |p| = r (1 - k . p), which has
its focus in the origin and the eccentricity e = r |k|; centre and axes follow. Adding half a square pixel over
1 - e^2 to both variances makes it cover the low pass, which is not concentric with it.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.raster.projection import RECORD
from engine.raster.settings import MAX_SIGMA_PX, TILE

LOW_PASS = 2.0
"""The screen-space kernel is exp(-LOW_PASS |d|^2 / 2), d in pixels: sigma sqrt(2) / 2."""

_WHOLE = MAX_SIGMA_PX**2
_FLATTEST = 0.01  # least 1 - e^2 of an ellipse that is still worth drawing; beyond, the whole image is searched
_NO_AREA = 1e-12  # square pixels: such a disc is seen from the edge, only the low pass shows
_STEEP = np.float32(1e18)
_LARGEST_EXPONENT = 87.0


@inlined
def _tangents(quats, log_scales, i, R):
    """The disc's two axes in the camera's frame, as long as its standard deviations."""
    w, x = np.float64(quats[4 * i]), np.float64(quats[4 * i + 1])
    y, z = np.float64(quats[4 * i + 2]), np.float64(quats[4 * i + 3])
    s = 2.0 / max(w * w + x * x + y * y + z * z, 1e-30)
    a = math.exp(min(max(np.float64(log_scales[3 * i]), -_LARGEST_EXPONENT), _LARGEST_EXPONENT))
    b = math.exp(min(max(np.float64(log_scales[3 * i + 1]), -_LARGEST_EXPONENT), _LARGEST_EXPONENT))
    u = (a * (1.0 - s * (y * y + z * z)), a * s * (x * y + w * z), a * s * (x * z - w * y))
    v = (b * s * (x * y - w * z), b * (1.0 - s * (x * x + z * z)), b * s * (y * z + w * x))
    return _turned(R, u), _turned(R, v)


@inlined
def _turned(R, a):
    return (
        R[0] * a[0] + R[1] * a[1] + R[2] * a[2],
        R[3] * a[0] + R[4] * a[1] + R[5] * a[2],
        R[6] * a[0] + R[7] * a[1] + R[8] * a[2],
    )


@inlined
def _covering_ellipse(p, k, reach):
    """Centre (x, y from the projected centre), two variances, covariance and determinant of an ellipse whose
    points at Mahalanobis^2 `reach` enclose all that shows; variances of `_WHOLE` where there is none."""
    rest = 1.0 - reach * (k[0] * k[0] + k[1] * k[1])  # 1 - e^2
    if rest < _FLATTEST:
        return 0.0, 0.0, _WHOLE, _WHOLE, 0.0, _WHOLE * _WHOLE
    x, y = p[0] * k[0] + p[1] * k[1], p[2] * k[0] + p[3] * k[1]
    far = math.sqrt(reach / rest)
    low = 1.0 / (LOW_PASS * rest)
    # Rows of a 2 x 3 matrix, so that the determinant is a sum of squares: no cancelling for needles.
    a0, a1, a2 = p[0], p[1], far * x
    b0, b1, b2 = p[2], p[3], far * y
    n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    aa, bb = (a0 * a0 + a1 * a1 + a2 * a2) / rest, (b0 * b0 + b1 * b1 + b2 * b2) / rest
    det = (n0 * n0 + n1 * n1 + n2 * n2) / (rest * rest) + low * (aa + bb) + low * low
    shift = -reach / rest
    return shift * x, shift * y, aa + low, bb + low, (a0 * b0 + a1 * b1 + a2 * b2) / rest, det


@inlined
def _write_disc(discs, o, u, v, p, k, l):
    discs[o], discs[o + 1], discs[o + 7] = np.float32(u), np.float32(v), np.float32(l)
    length = math.sqrt(p[0] * p[0] + p[1] * p[1])
    area = p[0] * p[3] - p[1] * p[2]
    if abs(area) < _NO_AREA:
        discs[o + 2], discs[o + 3], discs[o + 4] = _STEEP, np.float32(0.0), _STEEP
        discs[o + 5], discs[o + 6] = np.float32(0.0), np.float32(0.0)
    else:
        discs[o + 2] = np.float32(1.0 / length)
        discs[o + 3] = np.float32(-(p[0] * p[2] + p[1] * p[3]) / (length * area))
        discs[o + 4] = np.float32(length / area)
        discs[o + 5] = np.float32((p[0] * k[0] + p[1] * k[1]) / length)
        discs[o + 6] = np.float32((p[0] * k[1] - p[1] * k[0]) / length)


@inlined
def _tile(pixels, tiles):
    """Tile that holds a pixel centre at or before this coordinate, clipped to the image."""
    return np.int16(min(max(math.floor((pixels - 0.5) / TILE), 0.0), tiles - 1.0))


@parallel_kernel
def project_discs(means, quats, log_scales, logits, lens, chunk, records, discs, bounds, depths, index, counts, call):
    """Project every disc; its third scale is not looked at.

    Parameters
    ----------
    discs : flat, `RECORD` numbers a disc, out
        See above. The rest as for `engine.raster.projection.project`, but for `lens`, which is float64, and scratch.
    """
    extents, rects, covers = bounds
    n = logits.shape[0]
    L = lens
    R = (L[0], L[1], L[2], L[3], L[4], L[5], L[6], L[7], L[8])
    fx, fy, cx, cy = L[12], L[13], L[14], L[15]
    width, height, near, log2_skip, by_distance = L[20], L[21], L[23], L[24], L[28] != 0.0
    for part in share_of(counts.shape[0], call):
        filled = part * chunk
        for i in range(part * chunk, min(n, (part + 1) * chunk)):
            mean = (np.float64(means[3 * i]), np.float64(means[3 * i + 1]), np.float64(means[3 * i + 2]))
            x, y, z = _turned(R, mean)
            x, y, z = x + L[9], y + L[10], z + L[11]
            l = -math.log2(1.0 + math.exp(min(-np.float64(logits[i]), 700.0)))
            if not (z > near and l >= log2_skip):
                continue
            xz, yz = x / z, y / z
            a, b = _tangents(quats, log_scales, i, R)
            jx, jy = fx / z, fy / z
            p = (jx * (a[0] - xz * a[2]), jx * (b[0] - xz * b[2]), jy * (a[1] - yz * a[2]), jy * (b[1] - yz * b[2]))
            if not max(p[0] * p[0] + p[1] * p[1], p[2] * p[2] + p[3] * p[3]) <= _WHOLE:
                continue
            k = (a[2] / z, b[2] / z)
            u, v = xz * fx + cx, yz * fy + cy
            reach = (l - log2_skip) * (2.0 * math.log(2.0))
            ex, ey, var_x, var_y, cov, det = _covering_ellipse(p, k, reach)
            ex, ey = u + ex, v + ey
            if max(var_x, var_y) >= _WHOLE:
                ex, ey, var_x, var_y, cov, det = 0.5 * width, 0.5 * height, _WHOLE, _WHOLE, 0.0, _WHOLE**2
            hx, hy = math.sqrt(reach * var_x), math.sqrt(reach * var_y)
            if not (ex + hx >= 0.5 and ex - hx <= width - 0.5 and ey + hy >= 0.5 and ey - hy <= height - 0.5):
                continue
            o = i * RECORD
            _write_disc(discs, o, u, v, p, k, l)
            half = -0.5 * math.log2(math.e) / det
            records[o], records[o + 1] = np.float32(ex), np.float32(ey)
            records[o + 2] = np.float32(half * var_y)
            records[o + 3] = np.float32(-2.0 * half * cov)
            records[o + 4] = np.float32(half * var_x)
            records[o + 5] = np.float32(l)
            records[o + 6], records[o + 7] = np.float32(cov / var_y), np.float32(cov / var_x)
            extents[2 * i], extents[2 * i + 1] = np.float32(hx), np.float32(hy)
            rects[4 * i], rects[4 * i + 1] = _tile(ex - hx, L[25]), _tile(ex + hx, L[25])
            rects[4 * i + 2], rects[4 * i + 3] = _tile(ey - hy, L[26]), _tile(ey + hy, L[26])
            covers[i] = 0
            depths[filled], index[filled] = np.float32(math.sqrt(x * x + y * y + z * z) if by_distance else z), i
            filled += 1
        counts[part] = filled - part * chunk
