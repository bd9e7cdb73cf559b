"""Slow, obviously right twins of what training is made of: the photo loss, and Adam as its paper writes it."""

from __future__ import annotations

import numpy as np
import torch

from engine.model import Float64


def photo_loss(image: torch.Tensor, photo: torch.Tensor, ssim_weight: float) -> torch.Tensor:
    """(1 - w) L1 + w (1 - SSIM) in float64, every window on its own; autograd gives the gradient."""
    offsets = torch.arange(11, dtype=torch.float64) - 5
    line = torch.exp(-(offsets**2) / (2 * 1.5**2))
    window = torch.outer(line, line) / line.sum() ** 2
    total, count = torch.zeros((), dtype=torch.float64), 0
    for top in range(image.shape[0] - 10):
        for left in range(image.shape[1] - 10):
            for channel in range(image.shape[2]):
                x = image[top : top + 11, left : left + 11, channel]
                y = photo[top : top + 11, left : left + 11, channel]
                mx, my = (window * x).sum(), (window * y).sum()
                vx, vy = (window * (x - mx) ** 2).sum(), (window * (y - my) ** 2).sum()
                cov = (window * (x - mx) * (y - my)).sum()
                luminance = (2 * mx * my + 0.01**2) / (mx**2 + my**2 + 0.01**2)
                total = total + luminance * (2 * cov + 0.03**2) / (vx + vy + 0.03**2)
                count += 1
    return (1 - ssim_weight) * (image - photo).abs().mean() + ssim_weight * (1 - total / count)


def adam(parameter: Float64, gradients: list[Float64], rates: Float64) -> Float64:
    """The parameter after one step for each gradient; a rate for every entry."""
    first, second = np.zeros_like(parameter), np.zeros_like(parameter)
    for step, gradient in enumerate(gradients, 1):
        first = 0.9 * first + 0.1 * gradient
        second = 0.999 * second + 0.001 * gradient**2
        unbiased = first / (1 - 0.9**step), second / (1 - 0.999**step)
        parameter = parameter - rates * unbiased[0] / (np.sqrt(unbiased[1]) + 1e-15)
    return parameter
