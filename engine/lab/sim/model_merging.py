"""Attacks that merge Gaussians, as publishing tools do to make levels of detail (`compress.levels_of_detail`)."""

import numpy as np

from engine.compress.levels_of_detail import merge_pairs, merge_voxels
from engine.lab.sim.attack import Attacks
from engine.model import GaussianModel

__all__ = ["ATTACKS"]

ATTACKS: Attacks[GaussianModel] = Attacks("model")

_KEPT = (0.9, 0.7, 0.5, 0.25, 0.1, 0.05, 0.02)


@ATTACKS.add("merge neighbours, pair after pair", "kept share", 0.25, _KEPT, "(0, 1]")
def merge(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """NanoGS (Xiong et al. 2026, arXiv 2603.16103): mass is opacity times volume, and light adds up as in blending."""
    return merge_pairs(model, strength, surface=False)


@ATTACKS.as_code("merge", "kept share", 0.25, _KEPT, "(0, 1]")
def merge_published(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """SuperSplat's publishing and splat-transform's `--decimate`: mass is opacity times surface, and is kept."""
    return merge_pairs(model, strength, surface=True)


@ATTACKS.add("merge the Gaussians of a voxel, level after level", "kept share", 0.25, _KEPT, "(0, 1]")
def lod(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """The level of a voxel tree (Spark's) that has the share `strength` left: finer Gaussians become one."""
    return merge_voxels(model, strength)
