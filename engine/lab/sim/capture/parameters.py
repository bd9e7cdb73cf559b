"""The arrays under training, each with its Adam moments; the only mutable thing of a training."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.model import Float32, GaussianModel
from engine.numerics.adam import AdamMoments, adam_step
from engine.raster import Gradients

__all__ = ["NAMES", "Parameters"]

SH_REST = 20.0  # higher SH bands move so much slower than DC (INRIA)

NAMES = ("means", "log_scales", "quats", "opacity_logits", "sh")


class Parameters:
    """All parameters of a model under training; copies, so that the model given stays as it is."""

    def __init__(self, model: GaussianModel) -> None:
        self.arrays: dict[str, Float32] = {name: getattr(model, name).copy() for name in NAMES}
        self.moments = {name: AdamMoments.zeros(array) for name, array in self.arrays.items()}

    def __len__(self) -> int:
        return len(self.arrays["means"])

    @property
    def model(self) -> GaussianModel:
        """The parameters as they are now: a view, which the next step changes."""
        arrays: dict[str, Any] = dict(self.arrays)
        return GaussianModel(**arrays)

    def finished(self) -> GaussianModel:
        """A model of its own, with unit quaternions."""
        model = self.model.take(np.arange(len(self)))
        lengths = np.linalg.norm(model.quats, axis=1, keepdims=True)
        return model.with_(quats=model.quats / np.maximum(lengths, np.finfo(np.float32).tiny))

    def step(self, gradients: Gradients, rates: dict[str, float], number: int) -> None:
        """One Adam step of every parameter that has a rate; see `SH_REST`."""
        for name, rate in rates.items():
            rest = rate / SH_REST if name == "sh" else None
            adam_step(self.arrays[name], getattr(gradients, name), self.moments[name], rate, number, rate_rest=rest)

    def regroup(self, kept: npt.NDArray[np.int64], new: GaussianModel) -> None:
        """The Gaussians at `kept` with their moments, then the new ones, which start without any."""
        for name in NAMES:
            fresh: Float32 = getattr(new, name)
            self.arrays[name] = np.concatenate([self.arrays[name][kept], fresh])
            old, empty = self.moments[name], np.zeros_like(fresh)
            self.moments[name] = AdamMoments(*(np.concatenate([m[kept], empty]) for m in (old.first, old.second)))

    def raise_degree(self, coefficients: int) -> None:
        """More SH coefficients a channel; the new ones are 0 and have no moments."""
        missing = coefficients - self.arrays["sh"].shape[1]

        def grown(array: Float32) -> Float32:
            return np.concatenate([array, np.zeros((len(array), missing, 3), np.float32)], axis=1)

        old = self.moments["sh"]
        self.arrays["sh"] = grown(self.arrays["sh"])
        self.moments["sh"] = AdamMoments(grown(old.first), grown(old.second))

    def cap_opacity(self, opacity: float) -> None:
        """No Gaussian more opaque than this, and no moments left of it."""
        logit = np.float32(np.log(opacity / (1.0 - opacity)))
        logits = self.arrays["opacity_logits"]
        np.minimum(logits, logit, out=logits)
        self.moments["opacity_logits"] = AdamMoments.zeros(logits)
