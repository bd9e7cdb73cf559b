"""View distortions by name, with their strengths as data: what lenses, sensors, viewers and encoders do."""

from engine.model import Float32
from engine.sim.attack import Attack, Reading, Strength
from engine.sim.views import encoders, exposures, lenses, resizing, tones

__all__ = ["VIEW_ATTACKS"]

_SMALLER: tuple[Strength, ...] = (0.9, 0.75, 0.5, 0.35, 0.25)
_FACTORS: tuple[Strength, ...] = (2.0, 1.5, *_SMALLER)
_QUALITIES: tuple[Strength, ...] = (95, 90, 75, 50, 30, 20, 10)


def _image(name: str, summary: str, reading: Reading[Float32]) -> Attack[Float32]:
    return Attack(name, "image", summary, (reading,))


VIEW_ATTACKS: tuple[Attack[Float32], ...] = (
    _image(
        "lens_radial",
        "a lens with radial distortion: barrel or pincushion",
        Reading(
            lenses.lens_radial,
            "k1, below 0 a barrel",
            -0.1,
            (-0.01, 0.01, -0.03, 0.03, -0.1, 0.1, -0.2, 0.2, -0.3, 0.3),
        ),
    ),
    _image(
        "lens_brown",
        "a wide lens with radial and tangential distortion",
        Reading(lenses.lens_brown, "multiples of a calibrated lens", 0.5, (0.05, 0.1, 0.25, 0.5, 0.75, 1.0)),
    ),
    _image(
        "lens_fisheye",
        "a fisheye lens",
        Reading(lenses.lens_fisheye, "0 pinhole, 1/2 stereographic, 1 equidistant", 0.5, (0.05, 0.1, 0.25, 0.5, 1.0)),
    ),
    _image(
        "rolling_shutter",
        "a camera that pans while its rows are read",
        Reading(lenses.rolling_shutter, "shift of the last row, widths", 0.03, (0.002, 0.01, 0.03, 0.1, 0.2)),
    ),
    _image(
        "rolling_exposure",
        "a gain that changes from the first row to the last",
        Reading(exposures.rolling_exposure, "change of the gain", 0.3, (0.05, 0.1, 0.2, 0.3, 0.5, 0.8)),
    ),
    _image(
        "flicker",
        "bands of mains flicker",
        Reading(exposures.flicker, "depth of the bands", 0.1, (0.02, 0.05, 0.1, 0.2, 0.4)),
    ),
    _image(
        "vignette",
        "light lost towards the corners",
        Reading(exposures.vignette, "share lost in the corners", 0.3, (0.05, 0.1, 0.2, 0.3, 0.5, 0.7)),
    ),
    _image(
        "gamma",
        "every value to a power",
        Reading(tones.gamma, "exponent", 2.2, (0.9, 1.1, 0.8, 1.25, 0.6, 1.6, 0.4545, 2.2, 0.33, 3.0)),
    ),
    _image(
        "filmic",
        "the film curve of ACES over linear light",
        Reading(tones.filmic, "exposure", 1.0, (0.6, 0.8, 1.0, 1.5, 2.5, 4.0)),
    ),
    _image(
        "contrast",
        "distance from mid-grey multiplied, clipped",
        Reading(tones.contrast, "factor", 1.3, (0.95, 1.05, 0.8, 1.2, 1.3, 0.5, 1.6, 0.3, 2.5)),
    ),
    _image(
        "saturation",
        "distance from the pixel's grey multiplied, clipped",
        Reading(tones.saturation, "factor", 1.5, (0.9, 1.1, 0.7, 1.5, 0.3, 2.0, 0.0, 3.0)),
    ),
    _image(
        "white_balance",
        "warmer or cooler light",
        Reading(tones.white_balance, "red over blue", 1.3, (0.95, 1.05, 0.8, 1.3, 0.6, 1.7, 0.4, 2.5)),
    ),
    _image(
        "viewer_color",
        "a screenshot from a viewer that manages colour wrongly",
        Reading(tones.viewer_color, "mistake", "srgb_twice", tuple(tones.VIEWERS)),
    ),
    _image(
        "resize_nearest",
        "to another size and back, nearest pixel",
        Reading(resizing.resize_nearest, "factor on each side", 0.5, _SMALLER),
    ),
    _image(
        "resize_bilinear",
        "to another size and back, bilinear",
        Reading(resizing.resize_bilinear, "factor on each side", 0.5, _FACTORS),
    ),
    _image(
        "resize_area",
        "to another size and back, area means",
        Reading(resizing.resize_area, "factor on each side", 0.5, _SMALLER),
    ),
    _image(
        "resize_lanczos",
        "to another size and back, Lanczos",
        Reading(resizing.resize_lanczos, "factor on each side", 0.5, _FACTORS),
    ),
    _image("webp", "lossy WebP", Reading(encoders.webp, "quality", 50, _QUALITIES)),
    _image("avif", "AVIF with 4:2:0 chroma", Reading(encoders.avif, "quality", 50, _QUALITIES)),
    _image(
        "h264",
        "one frame of an H.264 film (needs the ffmpeg command)",
        Reading(encoders.h264, "constant rate factor", 23, (17, 20, 23, 28, 33, 38, 43)),
    ),
    _image(
        "h265",
        "one frame of an H.265 film (needs the ffmpeg command)",
        Reading(encoders.h265, "constant rate factor", 28, (20, 24, 28, 33, 38, 43)),
    ),
    _image(
        "mpeg4", "one frame of an MPEG-4 film written by OpenCV", Reading(encoders.mpeg4, "generations", 1, (1, 2, 5))
    ),
)
"""In the order of the documentation: moved pixels, light, tone, size, encoders."""
