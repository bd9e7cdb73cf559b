"""Refinement (Eq 9): an Adam run on the colours through the rasterizer and random distortion layers.

What moves is every Gaussian's own displacement; or, as in the paper, the code vectors, which Eq 6 and 7 hold near the
colours that they stand for.

Geometry is fixed, so each key view's fragments are prepared once and a step is two renders (the image, and the
derivative of the read-out) and two backward passes. Bits are read exactly as the verifier reads them: the VJP of
the residual image, gathered per chip. The planned amplitudes stay the decoder's weights: they are committed to
before the chips are drawn (DESIGN 4.9), so the refinement may move the model but never the weights.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from engine.compress.impact import seen_harmonics, uncertainty
from engine.flows.embed.asset import Asset
from engine.flows.embed.config import CONFIG
from engine.flows.embed.copy_mark import Mark, OwnerMark
from engine.flows.embed.distortions import draw
from engine.flows.embed.layer_strengths import Fidelity, add_dc, measure, solve_strength
from engine.flows.embed.profiles import RefineConfig
from engine.model import SH_C0, Camera, Float32, Float64, GaussianModel
from engine.numerics.wavelet import coefficient_detail, dwt2
from engine.raster import View, prepare_view, sh_colors
from engine.raster.cuda import CudaView
from engine.watermark.layout import Layout


class _Blend(torch.autograd.Function):
    """Image of colours under frozen geometry: linear, with the rasterizer's exact VJP."""

    @staticmethod
    def forward(ctx: Any, colors: Tensor, view: View | CudaView) -> Tensor:
        ctx.view = view
        return torch.from_numpy(view.render(colors.detach().numpy())[0])

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor, None]:
        cotangent = np.ascontiguousarray(cotangents[0].numpy())
        return torch.from_numpy(ctx.view.backward_colors(cotangent)), None


class _Pull(torch.autograd.Function):
    """The adjoint: per-Gaussian sums of a residual image; its own derivative is a render."""

    @staticmethod
    def forward(ctx: Any, residual: Tensor, view: View | CudaView) -> Tensor:
        ctx.view = view
        return torch.from_numpy(view.backward_colors(np.ascontiguousarray(residual.detach().numpy())))

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor, None]:
        return torch.from_numpy(ctx.view.render(np.ascontiguousarray(cotangents[0].numpy()))[0]), None


_blend: Callable[[Tensor, View | CudaView], Tensor] = _Blend.apply
_pull: Callable[[Tensor, View | CudaView], Tensor] = _Pull.apply


@dataclass(frozen=True, eq=False)
class Codes:
    """What holds displaced code vectors (Eq 6 and 7)."""

    left: Float32  # (N, D) g - c: what the unmarked code vectors leave of each Gaussian's colour
    weight: float  # of this loss
    lambda_freq: float  # of the detail in it


@dataclass(frozen=True, eq=False)
class Tint:
    """A mark of colours in closed form."""

    displacement: Float32  # (N, D) at its final strength, SH units: of DC, D = 3, or of all coefficients
    layout: Layout
    signed: Float64  # (C,) planned amplitude times chip times message sign: the matched filter
    bit_of: npt.NDArray[np.int32]  # (C,)
    bits: int


def refine(
    model: GaussianModel,
    tint: Tint,
    cameras: list[Camera],
    uncertainty: Float64,
    config: RefineConfig,
    advance: Callable[[float], None],
    codes: Codes | None = None,
    device: str = "cpu",
) -> Float32:
    """Improve the displacement of every Gaussian's colour.

    Gives (N, D) float32; the caller solves its strength again.

    Parameters
    ----------
    model : GaussianModel
        Unmarked.
    tint : Tint
        Where it starts.
    cameras : list of Camera
        Key views.
    uncertainty : (N,) float64
        Laplace uncertainty of the DC colour; scales each Gaussian's step.
    advance : callable
        Called with the fraction done.
    codes : Codes, optional
        Move the layout's code vectors, from the closed form of `tint.signed` on, not the Gaussians.
    device : str
        "cuda" draws the views, and pulls them, on the GPU.
    """
    displacement, layout, signed, bits = tint.displacement, tint.layout, tint.signed, tint.bits
    rng = np.random.default_rng(0)  # of views and distortions
    scale = config.size / max(cameras[0].width, cameras[0].height)
    small = [c.resized(max(16, round(c.width * scale)), max(16, round(c.height * scale))) for c in cameras]
    views = [CudaView(model, c) if device == "cuda" else prepare_view(model, c) for c in small]
    bases = [sh_colors(model.sh, model.means, c.position.astype(np.float32)) for c in small]
    colors = [torch.from_numpy(base) for base in bases]
    renders = [torch.from_numpy(view.render(base)[0]) for view, base in zip(views, bases, strict=True)]
    pattern, groups = _bit_patterns(tint)
    degree = int(np.sqrt(displacement.shape[1] // 3)) - 1
    harmonics = [torch.from_numpy(seen_harmonics(model, c, degree)) for c in small]
    rms = float(np.sqrt((displacement**2).mean()))
    doubt = np.clip(np.sqrt(uncertainty / np.median(uncertainty)), 0.3, 3.0).astype(np.float32)
    start, rows, doubt = (displacement, [], doubt) if codes is None else _code_vectors(layout, signed, doubt)
    delta = torch.from_numpy(start.copy()).requires_grad_(True)
    moment, square = torch.zeros_like(delta), torch.zeros_like(delta)
    for step in range(1, config.steps + 1):
        k = int(rng.integers(len(views)))
        layer = draw(rng)
        moved = _of_gaussians(delta, rows)  # (N, D)
        marked = _blend(torch.relu(colors[k] + _shown(moved, harmonics[k])), views[k])  # (H, W, 3)
        with torch.no_grad():
            clean = layer(renders[k].permute(2, 0, 1)[None])
        residual = (layer(marked.permute(2, 0, 1)[None]) - clean)[0].permute(1, 2, 0).contiguous()
        z = _soft_bits(_pull(residual, views[k]), pattern, groups, bits)
        message = torch.nn.functional.softplus(-z / CONFIG.plan.bit_temperature * 3.0).mean()  # BCE of the right bits
        change = marked - renders[k]
        reconstruction = change.abs().mean() / (rms * SH_C0)
        wavelet = sum(band.abs().mean() for band in dwt2(change, 2)[1][0]) / (rms * SH_C0)
        loss = config.lambda_msg * message + config.lambda_rec * reconstruction + config.lambda_wavelet * wavelet
        if codes is not None:
            loss = loss + codes.weight * _code_energy(torch.from_numpy(codes.left) - moved, codes.lambda_freq) / rms**2
        (gradient,) = torch.autograd.grad(loss, delta)
        with torch.no_grad():  # Adam, its step scaled by the uncertainty (paper: eta by the tile's uncertainty)
            moment.mul_(0.9).add_(gradient, alpha=0.1)
            square.mul_(0.99).addcmul_(gradient, gradient, value=0.01)
            update = (moment / (1 - 0.9**step)) / ((square / (1 - 0.99**step)).sqrt() + 1e-12)
            delta -= config.rate * update * torch.from_numpy(doubt)[:, None]
        advance(step / config.steps)
    with torch.no_grad():
        return np.asarray(_of_gaussians(delta, rows).numpy(), dtype=np.float32)


def _of_gaussians(delta: Tensor, rows: list[Tensor]) -> Tensor:
    """(N, D) displacement of every Gaussian: the sum of its code vectors', or with no rows its own."""
    if not rows:
        return delta
    # The gradient of delta[row] is summed in any order by several threads; that of this one always in one order.
    return torch.stack([delta.index_select(0, row) for row in rows]).sum(dim=0)


def _shown(displacement: Tensor, harmonics: Tensor) -> Tensor:
    """(N, 3) what a displacement (N, 3K) of the coefficients adds to the colours seen by a camera."""
    if harmonics.shape[1] == 1:
        return SH_C0 * displacement
    return (harmonics[:, :, None] * displacement.reshape(len(displacement), -1, 3)).sum(dim=1)


def _code_vectors(layout: Layout, signed: Float64, doubt: Float32) -> tuple[Float32, list[Tensor], Float32]:
    """(sum M, D) displacement of every code vector in closed form, the row (N,) of each Gaussian's in each stage, and
    the code vectors' doubt (sum M,), the mean of their members'."""
    parts = [part @ direction for part, direction in zip(layout.split(signed), layout.directions, strict=True)]
    firsts = np.concatenate([[0], np.cumsum(layout.codes)[:-1]])
    rows = [label + first for label, first in zip(layout.labels, firsts, strict=True)]
    means = [
        np.bincount(label, doubt, count) / np.maximum(np.bincount(label, minlength=count), 1)
        for label, count in zip(layout.labels, layout.codes, strict=True)
    ]
    start = np.concatenate(parts).astype(np.float32)
    return start, [torch.from_numpy(row.astype(np.int64)) for row in rows], np.concatenate(means).astype(np.float32)


def _code_energy(gap: Tensor, lambda_freq: float) -> Tensor:
    """Eq 7, mean over Gaussians and numbers of a colour, of the gaps g - c' (N, D)."""
    energy = gap.square().sum()
    if gap.shape[1] > 3:
        energy = energy + lambda_freq * coefficient_detail(gap.reshape(len(gap), -1, 3)).square().sum()
    return energy / gap.numel()


def _bit_patterns(tint: Tint) -> tuple[Tensor, list[Tensor]]:
    """Matched filter per stage and Gaussian in DC, (S, N, 3), and the bit of each Gaussian in each stage."""
    layout = tint.layout
    carriers = len(layout.directions[0])
    patterns, groups, start = [], [], 0
    for part, label, direction, count in zip(
        layout.split(tint.signed), layout.labels, layout.directions, layout.codes, strict=True
    ):
        patterns.append((part @ direction[:, :3]).astype(np.float32)[label])
        code_bit = tint.bit_of[start : start + count * carriers : carriers]
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
    asset: Asset, owner: OwnerMark, mark: Mark, bits: int, advance: Callable[[float], None]
) -> tuple[GaussianModel, Fidelity]:
    """The marked model with the owner's tint refined and its strength solved again, and what its worst view shows."""
    plan, delivered, kept = owner.settled.plan, asset.delivery.model, owner.settled.tint
    ground, views = asset.delivery.ground, asset.delivery.views
    codes, weight = None, asset.settings.paper.codes
    if weight > 0:
        width = plan.layout.width
        left = (ground.model.sh - delivered.sh).reshape(len(delivered), -1)[:, :width]
        codes = Codes(np.ascontiguousarray(left), weight, asset.settings.quantize.lambda_freq)
    displacement = refine(
        delivered,
        Tint(owner.tint, plan.layout, owner.signed, owner.drawn.tint.bit_of, bits),
        list(ground.cameras),
        uncertainty(ground.impact.squared),
        asset.settings.refine,
        advance,
        codes,
        asset.settings.device,
    )
    again = solve_strength(views, displacement, kept.psnr_db, kept.ssim, 1.0)
    marked = mark.model.with_(sh=add_dc(delivered.sh, np.float32(again.factor) * displacement + mark.copied))
    return marked, measure(views, marked)
