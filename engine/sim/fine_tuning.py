"""Fine-tuning a stolen model on pictures (paper, Table 5): Adam on all colour parameters, geometry frozen.

"Clean images" are renders of the unmarked model: the strongest position, since the optimum of the loss is then the
unmarked colours themselves. An epoch shows every picture once, in random order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.raster import prepare_view, sh_colors, sh_colors_backward

__all__ = ["fine_tune"]

RATE_DC = 0.0025
"""Adam step of the DC coefficients, INRIA's default (`feature_lr`)."""

RATE_REST = RATE_DC / 20.0
"""Adam step of the higher coefficients, INRIA's default."""


def fine_tune(
    model: GaussianModel,
    cameras: Sequence[Camera],
    images: Sequence[Float32],
    epochs: int,
    *,
    seed: int = 0,
    rate: float = RATE_DC,
    advance: Callable[[float], None] | None = None,
) -> GaussianModel:
    """Train the colours of a model on pictures with an L1 loss.

    Parameters
    ----------
    model : GaussianModel
        The marked model.
    cameras : sequence of Camera
    images : sequence of (H, W, 3) float32
        What the cameras should see.
    epochs : int
        Passes over all pictures.
    seed : int
        Of their order.
    rate : float
        Adam step of DC, SH units; the rest moves at a twentieth of it.
    advance : callable, optional
        Told the fraction done.

    Returns
    -------
    GaussianModel
    """
    if len(cameras) != len(images) or not cameras:
        raise InputError(f"{len(cameras)} cameras for {len(images)} pictures")
    rng = np.random.default_rng(seed)
    views = [prepare_view(model, camera) for camera in cameras]
    positions = [camera.position.astype(np.float32) for camera in cameras]
    dc, rest = torch.from_numpy(model.sh[:, :1].copy()), torch.from_numpy(model.sh[:, 1:].copy())
    groups = [{"params": [dc], "lr": rate}] + ([{"params": [rest], "lr": rate / 20}] if rest.numel() else [])
    optimizer = torch.optim.Adam(groups, eps=1e-15)
    for epoch in range(epochs):
        for k in rng.permutation(len(views)):
            sh = np.ascontiguousarray(np.concatenate([dc.numpy(), rest.numpy()], axis=1))
            colors = sh_colors(sh, model.means, positions[k])
            image = views[k].render(colors)[0]
            cotangent = np.sign(image - images[k]).astype(np.float32) / image.size  # gradient of the mean L1
            gradient = sh_colors_backward(views[k].backward_colors(cotangent), sh, model.means, positions[k])
            dc.grad = torch.from_numpy(np.ascontiguousarray(gradient[:, :1]))
            if rest.numel():
                rest.grad = torch.from_numpy(np.ascontiguousarray(gradient[:, 1:]))
            optimizer.step()
        if advance:
            advance((epoch + 1) / epochs)
    return model.with_(sh=np.concatenate([dc.numpy(), rest.numpy()], axis=1))
