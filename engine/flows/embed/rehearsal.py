"""What a scene promises: its mark planned and read from bad pictures before it is made.

Its strength is solved on the key views, with random chips and no landmarks. Then views that no key view was are
rendered large, kept as bad JPEG files and read as suspects would be. Under noise follows without rendering, from the
mark's PSNR and the number of chips that matter,

    z = 1 / sqrt(1 / (efficiency^2 S) + 1 / E),   S = 3 P 10^(-PSNR / 10) / noise^2,   P pixels, E chips.

The lower z is what the scene promises.
"""

import math
from dataclasses import dataclass

import numpy as np

from engine.flows.embed.config import CONFIG
from engine.flows.embed.delivery import Delivery
from engine.flows.embed.layer_strengths import add_dc, first_guess, solve_strength
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.views.view_set import look
from engine.kernels.jit import side_by_side
from engine.model import Float32
from engine.numerics.image_metrics import psnr
from engine.watermark.image_evidence import gather_displacements
from engine.watermark.layout import Layout
from engine.watermark.masses import find_masses
from engine.watermark.planning import make_plan
from engine.watermark.statistics import claim_z

__all__ = ["Rehearsal", "Rehearsing"]

_CONFIG = CONFIG.rehearsal
REHEARSAL_SEED = 0x5EED


@dataclass(frozen=True)
class Rehearsal:
    """What a scene promises under some settings."""

    # Of the claim from one bad picture of an unseen view: at JPEG quality 10, the worst of several, or under noise of
    # std 0.1, whichever is lower
    predicted_z: float
    psnr_db: float  # of the mark, worst key view; above the wanted one where SSIM limits
    held_out_db: float  # of the mark, worst of some views that are not key views


class Rehearsing:
    """A scene with a mark planned on its key views, whose strength is still open."""

    def __init__(self, delivery: Delivery) -> None:
        self.delivery = delivery
        model, ground, config = delivery.model, delivery.ground, delivery.settings
        rng = np.random.default_rng(REHEARSAL_SEED)
        self._unseen = look(model, ground.unseen(_CONFIG.held_out, _CONFIG.side, rng), lambda fraction: None)
        self._telling = list(range(len(self._unseen.views)))  # which of them are read
        moving = None
        if config.output == "fidelity":
            moving = (~find_masses(model.sh[:, 0], config.plan.mass_share)).astype(np.float32)
        self._plan = make_plan(delivery.stages, ground.impact, config.plan, multiples=moving)
        layout = self._plan.layout
        self._signs = rng.choice((-1.0, 1.0), layout.chips).astype(np.int8)
        self._displacement = layout.displace(layout.amplitudes * self._signs)

    def at(self, config: EmbedConfig) -> Rehearsal:
        """What these settings' fidelity promises."""
        delivery, energies = self.delivery, self._plan.energies  # (V, C)
        totals = energies.sum(axis=1)
        # What the grain may take of the fidelity is not the tint's, which alone a bad picture shows.
        grained = config.plan.grain_center > 0 or config.plan.grain_scale > 0
        rest = 1.0 - CONFIG.strength.grain_ssim_share if grained else 1.0
        room_db = -10.0 * math.log10(rest)
        start = first_guess(energies, delivery.views.cameras, config.psnr_db + room_db)
        wanted = config.psnr_db + room_db, 1.0 - rest * (1.0 - config.ssim)
        strength = solve_strength(delivery.views, self._displacement, *wanted, start)
        layout = self._plan.times(strength.factor).layout
        marked = add_dc(delivery.model.sh, np.float32(strength.factor) * self._displacement)
        pictures = [self._unseen.render(k, marked) for k in range(len(self._unseen.views))]
        held_out_db = min(psnr(a, b) for a, b in zip(self._unseen.images, pictures, strict=True))
        # Most of it is NumPy on one thread.
        read = side_by_side(lambda k: self._read(pictures[k], k, layout), self._telling)
        found = sorted(zip(read, self._telling, strict=True))
        self._telling = [k for _, k in found[: _CONFIG.worst]]
        chips = float((totals**2 / np.maximum((energies**2).sum(axis=1), 1e-300)).min())  # that matter
        signal = 3.0 * _CONFIG.side**2 * 10 ** (-strength.psnr_db / 10.0) / _CONFIG.noise**2
        noisy = 1.0 / math.sqrt(1.0 / max(_CONFIG.noise_efficiency**2 * signal, 1e-12) + 1.0 / max(chips, 1e-12))
        return Rehearsal(min(found[0][0], noisy), strength.psnr_db - room_db, held_out_db - room_db)

    def _read(self, picture: Float32, number: int, layout: Layout) -> float:
        """z of the claim from an unseen view of the marked model, kept badly."""
        plain, marked = (np.clip(image, 0.0, 1.0) for image in (self._unseen.images[number], picture))
        y = gather_displacements(layout, self._unseen.views[number], plain, _spoil(marked), _CONFIG.quality)
        one_bit = np.zeros(layout.chips, dtype=np.int32)
        return claim_z(y, layout.amplitudes, one_bit, self._signs, np.ones(1, dtype=np.int8))


def _spoil(picture: Float32) -> Float32:
    """The picture after JPEG."""
    import cv2

    stored = np.round(picture[..., ::-1] * 255.0).astype(np.uint8)
    coded = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, _CONFIG.quality])[1]
    decoded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.float32)
    return decoded[..., ::-1] / np.float32(255.0)
