"""Refinement (Eq 9): a short Adam run on the colours through the rasterizer and random distortion layers.

Geometry is fixed, so each key view's fragments are prepared once and a step is two renders (the image, and the
derivative of the read-out) and two backward passes. Bits are read exactly as the verifier reads them: the VJP of
the residual image, gathered per chip. The planned amplitudes stay the decoder's weights: they are committed to
before the chips are drawn (DESIGN 4.9), so the refinement may move the model but never the weights.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from engine.compress.impact import uncertainty
from engine.model import SH_C0, Camera, Float32, Float64, GaussianModel
from engine.numerics.wavelet import dwt2
from engine.pipeline.asset import Asset
from engine.pipeline.distortions import draw
from engine.pipeline.marking import Mark
from engine.pipeline.profiles import RefineConfig
from engine.pipeline.settling import measure
from engine.pipeline.strength import Fidelity, add_dc, solve_strength
from engine.raster import View, prepare_view, sh_colors
from engine.watermark.layout import Layout

BIT_TEMPERATURE = 4.0
"""z per bit at which the message loss saturates: z = 4 is a bit error of 3e-5."""


class _Blend(torch.autograd.Function):
    """Image of colours under frozen geometry: linear, with the rasterizer's exact VJP."""

    @staticmethod
    def forward(ctx: Any, colors: Tensor, view: View) -> Tensor:
        ctx.view = view
        return torch.from_numpy(view.render(colors.detach().numpy())[0])

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor, None]:
        cotangent = np.ascontiguousarray(cotangents[0].numpy())
        return torch.from_numpy(ctx.view.backward_colors(cotangent)), None


class _Pull(torch.autograd.Function):
    """The adjoint: per-Gaussian sums of a residual image; its own derivative is a render."""

    @staticmethod
    def forward(ctx: Any, residual: Tensor, view: View) -> Tensor:
        ctx.view = view
        return torch.from_numpy(view.backward_colors(np.ascontiguousarray(residual.detach().numpy())))

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor, None]:
        return torch.from_numpy(ctx.view.render(np.ascontiguousarray(cotangents[0].numpy()))[0]), None


_blend: Callable[[Tensor, View], Tensor] = _Blend.apply
_pull: Callable[[Tensor, View], Tensor] = _Pull.apply


def refine(
    model: GaussianModel,
    displacement: Float32,
    cameras: list[Camera],
    layout: Layout,
    signed: Float64,
    bit_of: npt.NDArray[np.int32],
    bits: int,
    uncertainty: Float64,
    config: RefineConfig,
    advance: Callable[[float], None],
    seed: int = 0,
) -> Float32:
    """Improve the displacement of every Gaussian's DC colour.

    Gives (N, 3) float32; the caller solves its strength again.

    Parameters
    ----------
    model : GaussianModel
        Unmarked.
    displacement : (N, 3) float32
        Closed-form mark at its final strength, SH units.
    cameras : list of Camera
        Key views.
    signed : (C,) float64
        Planned amplitude times chip times message sign: the matched filter.
    bit_of : (C,) int32
    uncertainty : (N,) float64
        Laplace uncertainty of the DC colour; scales each Gaussian's step.
    advance : callable
        Told the fraction done.
    seed : int
        Of views and distortions.
    """
    rng = np.random.default_rng(seed)
    scale = config.size / max(cameras[0].width, cameras[0].height)
    small = [c.resized(max(16, round(c.width * scale)), max(16, round(c.height * scale))) for c in cameras]
    views = [prepare_view(model, c) for c in small]
    bases = [sh_colors(model.sh, model.means, c.position.astype(np.float32)) for c in small]
    colors = [torch.from_numpy(base) for base in bases]
    renders = [torch.from_numpy(view.render(base)[0]) for view, base in zip(views, bases, strict=True)]
    pattern, groups = _bit_patterns(layout, signed, bit_of, bits)
    delta = torch.from_numpy(displacement.copy()).requires_grad_(True)
    rms = float(np.sqrt((displacement**2).mean()))
    doubt = np.clip(np.sqrt(uncertainty / np.median(uncertainty)), 0.3, 3.0).astype(np.float32)
    moment, square = torch.zeros_like(delta), torch.zeros_like(delta)
    for step in range(1, config.steps + 1):
        k = int(rng.integers(len(views)))
        layer = draw(rng)
        marked = _blend(torch.relu(colors[k] + SH_C0 * delta), views[k])  # (H, W, 3)
        with torch.no_grad():
            clean = layer(renders[k].permute(2, 0, 1)[None])
        residual = (layer(marked.permute(2, 0, 1)[None]) - clean)[0].permute(1, 2, 0).contiguous()
        z = _soft_bits(_pull(residual, views[k]), pattern, groups, bits)
        message = torch.nn.functional.softplus(-z / BIT_TEMPERATURE * 3.0).mean()  # BCE of the right bits
        change = marked - renders[k]
        reconstruction = change.abs().mean() / (rms * SH_C0)
        wavelet = sum(band.abs().mean() for band in dwt2(change, 2)[1][0]) / (rms * SH_C0)
        loss = config.lambda_msg * message + config.lambda_rec * reconstruction + config.lambda_wavelet * wavelet
        (gradient,) = torch.autograd.grad(loss, delta)
        with torch.no_grad():  # Adam, its step scaled by the uncertainty (paper: eta by the tile's uncertainty)
            moment.mul_(0.9).add_(gradient, alpha=0.1)
            square.mul_(0.99).addcmul_(gradient, gradient, value=0.01)
            update = (moment / (1 - 0.9**step)) / ((square / (1 - 0.99**step)).sqrt() + 1e-12)
            delta -= config.rate * update * torch.from_numpy(doubt)[:, None]
        advance(step / config.steps)
    return delta.detach().numpy()


def _bit_patterns(
    layout: Layout, signed: Float64, bit_of: npt.NDArray[np.int32], bits: int
) -> tuple[Tensor, list[Tensor]]:
    """Matched filter per stage and Gaussian, (S, N, 3), and the bit of each Gaussian in each stage."""
    carriers = len(layout.directions[0])
    patterns, groups, start = [], [], 0
    for part, label, direction, count in zip(
        layout.split(signed), layout.labels, layout.directions, layout.codes, strict=True
    ):
        patterns.append((part @ direction).astype(np.float32)[label])
        code_bit = bit_of[start : start + count * carriers : carriers]
        groups.append(torch.from_numpy(code_bit[label].astype(np.int64)))
        start += count * carriers
    return torch.from_numpy(np.stack(patterns)), groups


def _soft_bits(pulled: Tensor, pattern: Tensor, groups: list[Tensor], bits: int) -> Tensor:
    """(B,) z of each bit, positive when right: T_b over the spread of the bits' sums."""
    total = torch.zeros(bits)
    energy = torch.zeros(bits)
    for stage, group in zip(pattern, groups, strict=True):
        contribution = (pulled * stage).sum(dim=1)
        total = total.index_add(0, group, contribution)
        energy = energy.index_add(0, group, contribution.detach() ** 2)
    return total / (energy.sqrt() + 1e-12)


def refine_mark(
    asset: Asset, mark: Mark, bits: int, advance: Callable[[float], None]
) -> tuple[GaussianModel, Fidelity]:
    """The marked model with its tint refined and its strength solved again, and what its worst view shows."""
    plan, delivered, tint = mark.settled.plan, asset.delivered, mark.settled.tint
    displacement = refine(
        delivered,
        plan.layout.displace(mark.signed),
        list(asset.ground.cameras),
        plan.layout,
        mark.signed,
        mark.spreading.bit_of,
        bits,
        uncertainty(asset.ground.impact.squared),
        asset.settings.refine,
        advance,
    )
    again = solve_strength(asset.views, displacement, tint.psnr_db, tint.ssim, 1.0)
    marked = mark.model.with_(sh=add_dc(delivered.sh, np.float32(again.factor) * displacement))
    return marked, measure(asset.views, marked)
