"""Removal: what who has read this code, and has no key, pays in decibels to take the mark out of a model.

He knows how cells are made, what both layers move and by how much; not the signs, nor which cells a copy's key joins.

- *Washing*: public cells of the stolen model; what a plane through the neighbours does not explain of each one's colour
  is taken off (all of it, or a multiple of the mark's size with a soft limit, which cleans best for its price).
- *Smoothing*: every colour becomes the mean of its neighbours'.
- *Shaking*: every centre moved by a multiple of its own size, sizes by half as much at most, the order drawn anew.
- Shaking and smoothing together.
- *Cells of one's own*: every colour becomes the mean of a cell that place and colour make together, or that of one of
  its Gaussians, drawn at random; or cells of means are moved by noise, cell by cell. Then shaking.
- *Network*: every colour becomes what a small network, fitted to the model, tells of it from place and a noisy colour.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from engine.flows.embed.layer_strengths import add_dc
from engine.flows.embed.profiles import profile as named_profile
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.lab.evaluate.bench.attacks import claim_row, to_8_bit
from engine.lab.evaluate.marked_scene import mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.laundering import shake, smooth
from engine.lab.sim.attack import Strength
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE
from engine.watermark.unpredictability import public_misfit

WASHES = (2.0, 4.0, 5.5, 8.0, np.inf)
"""Multiples of the mark's usual size that are taken off at most; without limit, all that is not explained."""
SOFT = 0.5
"""Of the mark's size: from there on what is not explained counts as mark."""
SMOOTH = (8, 32)
"""Neighbours of which a colour becomes the mean."""
SHAKES = (0.3, 1.0, 2.0, 4.0)
"""Standard deviation of a centre's move, in the Gaussian's own size along each axis."""
CELLS = (2000, 1000, 500)
"""Cells of one's own, drawn from the model."""
MEMBERS = 1000
"""Cells whose colour is one Gaussian's."""
DROWNED = (2000, 4000, 0.4)
"""Cells of means, other cells that are moved then, and by how much: standard deviation of a harmonic."""
NOISY = 2.4
"""Noise of the color that the network sees, harmonics: the place says most."""
CHAINS: tuple[tuple[str, tuple[tuple[str, Strength], ...]], ...] = (
    ("lattice", (("lattice", "all"),)),
    ("lattice, smoothed over 64", (("lattice", "all"), ("smooth_colors", 64))),
    ("purified over 8", (("purify_train", 8),)),
    ("purified over 32", (("purify_train", 32),)),
    ("purified over 64", (("purify_train", 64),)),
    ("chaff", (("chaff", 3.0),)),
    *((f"through .{form}", (("convert", form),)) for form in ("splat", "spz", "sog", "compressed.ply")),
    *((f"through .{form}, lattice", (("convert", form), ("lattice", "all"))) for form in ("spz", "sog")),
)
"""Attacks of the laboratory, chained."""
PICTURES = 3
SIDE = 640


def wash(model: GaussianModel, times: float, size: float) -> GaussianModel:
    """Colours without what the neighbouring cells do not explain, of which at most `times` the mark's `size` goes."""
    missed = public_misfit(model, measure_extent(model).radius)
    taken = missed if np.isinf(times) else times * size * np.tanh(missed / (SOFT * size))
    return model.with_(sh=add_dc(model.sh, -taken.astype(np.float32)))


def cells(model: GaussianModel, count: int, seed: int) -> npt.NDArray[np.intp]:
    """(N,) the cell of each Gaussian, of `count` about random ones: by place, in distances to 32 neighbours, and DC."""
    means, dc = model.means.astype(np.float64), model.sh[:, 0].astype(np.float64)
    reach = np.median(cKDTree(means).query(means, 33, workers=2)[0][:, -1])
    places = np.concatenate([means / reach, dc], axis=1)
    drawn = np.random.default_rng(seed).choice(len(model), min(count, len(model)), replace=False)
    return np.asarray(cKDTree(places[drawn]).query(places, workers=2)[1])


def own_cells(model: GaussianModel, count: int, seed: int) -> GaussianModel:
    """Colours as the means of cells."""
    cell = cells(model, count, seed)
    sizes = np.maximum(np.bincount(cell), 1)
    colors = np.stack([np.bincount(cell, column) / sizes for column in model.sh[:, 0].T], axis=1)
    return model.with_dc(colors[cell].astype(np.float32))


def members(model: GaussianModel, count: int, seed: int) -> GaussianModel:
    """Colours as that of one Gaussian of each cell, drawn at random."""
    cell = cells(model, count, seed)
    order = np.random.default_rng(seed).permutation(len(model))
    chosen = np.zeros(cell.max() + 1, dtype=np.intp)
    chosen[cell[order]] = order
    return model.with_dc(model.sh[chosen[cell], 0])


def drowned(model: GaussianModel, count: int, size: float, seed: int) -> GaussianModel:
    """Colours moved by noise that is the same in a whole cell, most of it brightness."""
    cell, rng = cells(model, count, seed + 1), np.random.default_rng(seed)
    bright, rest = rng.standard_normal((count, 1)), rng.standard_normal((count, 3))
    moves = size * (np.sqrt(0.7) * bright + np.sqrt(0.3) * rest)
    return model.with_dc(model.sh[:, 0] + moves[cell].astype(np.float32))


def network_colors(model: GaussianModel, noise: float, seed: int) -> GaussianModel:
    """Colours as a network of two hidden layers tells them from place (Fourier features, Tancik et al. 2020) and the
    colour, which had noise while it was fitted."""
    import torch

    torch.manual_seed(seed)
    places = model.means.astype(np.float64) - np.median(model.means, axis=0)
    places /= np.quantile(np.abs(places), 0.9)
    waves = places @ np.random.default_rng(seed).normal(0.0, 8.0, (3, 64))
    known = torch.from_numpy(np.concatenate([np.sin(waves), np.cos(waves), places], axis=1).astype(np.float32))
    colors = torch.from_numpy(np.ascontiguousarray(model.sh[:, 0]))
    sides = (known.shape[1] + 3, 128, 128)
    hidden = [each for a, b in pairwise(sides) for each in (torch.nn.Linear(a, b), torch.nn.SiLU())]
    network = torch.nn.Sequential(*hidden, torch.nn.Linear(sides[-1], 3))
    optimizer = torch.optim.Adam(network.parameters(), 4e-3)
    slower = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 1500)
    for _ in range(1500):
        rows = torch.randint(0, len(colors), (4096,))
        seen = colors[rows] + noise * torch.randn(len(rows), 3)
        loss = (network(torch.cat([known[rows], seen], dim=1)) - colors[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        slower.step()
    with torch.no_grad():
        return model.with_dc(network(torch.cat([known, colors], dim=1)).numpy())


def _ways(model: GaussianModel, size: float, seed: int) -> Iterator[tuple[str, GaussianModel]]:
    yield "none", model
    for times in WASHES:
        yield f"washed, {times:g} of the mark", wash(model, times, size)
    for count in SMOOTH:
        yield f"smoothed over {count}", smooth(model, count)
    for sigma in SHAKES:
        shaken = shake(model, sigma, np.random.default_rng(seed))
        yield f"shaken by {sigma:g}", shaken
        yield f"shaken by {sigma:g}, smoothed over {SMOOTH[0]}", smooth(shaken, SMOOTH[0])
    own = {f"means of {count:,} own cells": own_cells(model, count, seed) for count in CELLS}
    own[f"members of {MEMBERS:,} own cells"] = members(model, MEMBERS, seed)
    count, others, noise = DROWNED
    noisy = drowned(own_cells(model, count, seed), others, noise, seed)
    own[f"means of {count:,} own cells, noise of {noise:g} in {others:,} others"] = noisy
    own["colors of a network"] = network_colors(model, NOISY, seed)
    for name, suspect in own.items():
        yield f"{name}, shaken by {SHAKES[0]:g}", shake(suspect, SHAKES[0], np.random.default_rng(seed))
    for name, chain in CHAINS:
        suspect = model
        for attack, strength in chain:
            suspect = model_attack(attack).apply(suspect, strength, rng=seed)
        yield name, suspect


def measure_removal(scene: str, seed: int, profile: str) -> list[Row]:
    """Each way at each strength: decibels against the original, z of the model and of three pictures of it."""
    marked = mark_scene(scene, named_profile(profile, landmark_views=0), seed=seed)
    model, layout = marked.marked, marked.opened.layout
    size = float(np.sqrt(np.square(layout.displace(layout.amplitudes)).mean()))
    jitter = np.random.default_rng(seed).random((2 * PICTURES, 4))
    cameras = make_rig(marked.original, 2 * PICTURES, SIDE, SIDE, jitter=jitter)
    shown, judged = cameras[::2], cameras[1::2]
    truth = [render(marked.original, camera) for camera in judged]
    rows = []
    for name, suspect in _ways(model, size, seed):
        found = verify_model(suspect, marked.opened, VerifyConfig(false_claim_rate=DISHONEST_CLAIMANT_RATE))
        pictures = [to_8_bit(render(suspect, camera)) for camera in shown]
        seen = verify_images(pictures, marked.opened, cameras=shown).claim
        paid = min(psnr(a, render(suspect, camera)) for a, camera in zip(truth, judged, strict=True))
        row = {"scene": marked.name, "psnr_db": paid, **claim_row(name, found), "layers": found.claim.layers}
        rows.append(row | {"route": found.claim.route, "z_pictures": seen.z, "pictures": seen.verdict.value})
    return rows
