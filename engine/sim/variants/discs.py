"""2DGS made from 3DGS, and its row of Table 4.

No trained 2DGS file is at hand, so discs are **made, not trained**: a Gaussian model loses its smallest axis, its
discs are widened by what a 3DGS rasterizer adds to every splat, and their colours are fitted to renders of the
original. What a trained 2DGS has beside (surfaces that agree with each other, normals) this has not; what matters
to a mark is alike: two scales, the ray-splat intersection, colours that a 2DGS viewer shows.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from engine.errors import InputError
from engine.formats import encode_model, read_model
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.flattening import flatten
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.rigs import make_rig
from engine.pipeline.sealing import OpenedRecord, open_record
from engine.pipeline.verification import Verification, VerifyConfig, verify_images, verify_model
from engine.raster import RasterSettings, render
from engine.sim.attacks import image_attack, model_attack
from engine.sim.fine_tuning import fine_tune
from engine.sim.variants.table4 import VariantRow, fidelity_for, measure_variant
from engine.watermark.keys import OwnerKey

__all__ = ["DISC_MODEL_ATTACKS", "DISC_PICTURE_ATTACKS", "fit_colors", "make_discs", "measure_discs", "widen"]

FIT_VIEWS, FIT_SIZE, FIT_EPOCHS = 12, 512, 2
"""Views of the regular rig, pixels a side, and passes over them, in which colours are fitted."""

DISC_MODEL_ATTACKS: tuple[tuple[str, str, float | str], ...] = (
    ("clone 50 %", "clone", 0.5),
    ("prune random 50 %", "prune_random", 0.5),
    ("crop to 10 %", "crop", 0.1),
    ("noise 0.1 on all", "noise_all", 0.1),
    ("SH cut to degree 0", "drop_sh", 0),
    ("quantised to 8 bits", "quantize", 8),
    (".spz and back", "convert", "spz"),
    (".sog and back", "convert", "sog"),
)
"""Case, attack and strength, on the marked model."""

DISC_PICTURE_ATTACKS: tuple[tuple[str, str, float], ...] = (
    ("JPEG 10", "jpeg", 10.0),
    ("noise 0.1", "noise_image", 0.1),
    ("rotation 30", "rotate_image", 30.0),
    ("crop 40 % of the area", "crop_image", 0.4),
)
"""Case, attack and strength, on one picture of the marked model, its camera known."""


def make_discs(
    model: GaussianModel, epochs: int = FIT_EPOCHS, advance: Callable[[float], None] | None = None
) -> GaussianModel:
    """A 3DGS model as discs that look like it: flattened, widened, colours fitted. Made, not trained.

    Parameters
    ----------
    epochs : int
        Passes of the colour fit over its views; 0 leaves the colours alone.
    advance : callable, optional
        Told the fraction done.

    Returns
    -------
    GaussianModel
        Same count and order; `is_flat`.
    """
    cameras = make_rig(model, FIT_VIEWS, FIT_SIZE, FIT_SIZE)
    return fit_colors(widen(flatten(model), cameras), model, cameras, epochs, advance)


def widen(discs: GaussianModel, cameras: Sequence[Camera]) -> GaussianModel:
    """Discs with the dilation that 3DGS adds on the screen folded into their scales.

    EWA splatting adds `eps2d` square pixels to both variances of every splat, 2DGS nothing. Here that amount goes
    to the two scales, at the mean magnification (pixels a scene unit) of the cameras that see the disc's centre in
    front of them. Measured on real scenes: 4 to 5 dB.

    Parameters
    ----------
    discs : GaussianModel
        With `is_flat`.
    cameras : sequence of Camera
        At the size in pixels at which the discs are to look right.
    """
    if not cameras:
        raise InputError("discs are widened for cameras, none was given")
    settings = RasterSettings()
    magnification, seen = np.zeros(len(discs)), np.zeros(len(discs))
    for camera in cameras:
        z = discs.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        ahead = z > settings.near
        magnification[ahead] += np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / z[ahead]
        seen += ahead
    pixels = magnification / np.maximum(seen, 1.0)  # of one scene unit; 0 where no camera looks
    added = settings.eps2d / np.maximum(pixels, 1e-30) ** 2 * (seen > 0)
    log_scales = discs.log_scales.copy()
    variances = np.exp(2.0 * log_scales[:, :2].astype(np.float64)) + added[:, None]
    log_scales[:, :2] = 0.5 * np.log(variances)
    return flatten(discs.with_(log_scales=log_scales))


def fit_colors(
    discs: GaussianModel,
    original: GaussianModel,
    cameras: Sequence[Camera],
    epochs: int,
    advance: Callable[[float], None] | None = None,
) -> GaussianModel:
    """Discs whose colours are fitted to renders of the original; geometry and opacity are held.

    Parameters
    ----------
    discs, original : GaussianModel
        The discs, and the 3DGS model that they should look like.
    cameras : sequence of Camera
        Views of both.
    epochs : int
        Passes of Adam on SH (see `fine_tune`) over the views; 0 gives the discs back.
    advance : callable, optional
        Told the fraction done.

    Returns
    -------
    GaussianModel
        Only its `sh` differs from the discs'.
    """
    if epochs == 0:
        return discs
    truth = [np.clip(render(original, camera), 0.0, 1.0) for camera in cameras]
    return discs.with_(sh=fine_tune(discs, cameras, truth, epochs, trained="colors", advance=advance).sh)


def measure_discs(
    original: GaussianModel,
    discs: GaussianModel,
    key: OwnerKey,
    config: EmbedConfig,
    *,
    bits: int = 32,
    views: int = 6,
    size: int = 512,
    seed: int = 0,
) -> VariantRow:
    """Mark discs and fill their row of Table 4.

    The discs go through their own file (PLY with two scales) before the mark and after it. The truth is the
    original 3DGS model's own render, as the paper measures against ground truth.

    Parameters
    ----------
    discs : GaussianModel
        Made from it, `is_flat`.
    config : EmbedConfig
        Its fidelity is raised as far as `fidelity_for` asks. With ``landmark_views=0`` the picture whose camera
        has to be found is left out.
    bits : int
        Length of the message.
    views, size : int
        Views measured on (jittered, none of which the mark or the fit has seen) and their side, pixels.
    seed : int
        Of the views and the attacks.

    Returns
    -------
    VariantRow
        Evidence from the model without attack and after `DISC_MODEL_ATTACKS`; from renders of the suspect at
        the pose key; from one picture, without attack, after `DISC_PICTURE_ATTACKS`, and drawn as thin Gaussians
        as a 3DGS viewer does; and from one picture whose camera is not known.
    """
    if not discs.is_flat:
        raise InputError("a 2DGS model has two scales, this one has three")
    file = encode_model(discs, "ply")
    discs = read_model(file).model
    jitter = np.random.default_rng(seed).random((views, 4))
    cameras = make_rig(original, views, size, size, jitter=jitter)
    truth, before = ([np.clip(render(model, camera), 0.0, 1.0) for camera in cameras] for model in (original, discs))
    config = replace(config, psnr_db=fidelity_for(truth, before, config.psnr_db))
    result = embed(discs, key, original_sha256=hashlib.sha256(file).hexdigest(), bits=bits, config=config)
    opened = open_record(result.record.to_bytes(key), key)
    marked = read_model(encode_model(result.model, "ply")).model
    after = [np.clip(render(marked, camera), 0.0, 1.0) for camera in cameras]
    readings = _model_readings(marked, opened, seed)
    readings |= _picture_readings(marked, after[0], cameras[0], opened, seed)
    return measure_variant("2DGS (made from 3DGS)", truth, before, after, readings)


def _model_readings(marked: GaussianModel, opened: OpenedRecord, seed: int) -> dict[str, Callable[[], Verification]]:
    def read(route: str, attack: str = "", strength: float | str = 0.0) -> Callable[[], Verification]:
        def run() -> Verification:
            suspect = model_attack(attack).apply(marked, strength, rng=seed) if attack else marked
            return verify_model(suspect, opened, VerifyConfig(route=route))

        return run

    cases = {"none": read("model"), "none, renders at the pose key": read("render")}
    return cases | {case: read("model", name, strength) for case, name, strength in DISC_MODEL_ATTACKS}


def _picture_readings(
    marked: GaussianModel, picture: Float32, camera: Camera, opened: OpenedRecord, seed: int
) -> dict[str, Callable[[], Verification]]:
    def read(image: Callable[[], Float32], known: bool = True) -> Callable[[], Verification]:
        return lambda: verify_images([image()], opened, cameras=[camera] if known else None)

    def attacked(name: str, strength: float) -> Callable[[], Float32]:
        return lambda: image_attack(name).apply(picture, strength, rng=seed)

    thin = RasterSettings(kernel="gaussian")
    cases = {
        "one picture": read(lambda: picture),
        "one picture, drawn as thin Gaussians": read(lambda: np.clip(render(marked, camera, settings=thin), 0.0, 1.0)),
    }
    for case, name, strength in DISC_PICTURE_ATTACKS:
        cases[f"one picture, {case}"] = read(attacked(name, strength))
    if opened.landmarks is not None:
        cases["one picture, camera not known"] = read(lambda: picture, known=False)
    return cases
