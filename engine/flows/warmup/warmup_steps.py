"""The kernels a job will need, step by step: each step does a little of the work on a scene too small to take time.

Run as a program it makes the steps ready that it reads, one a line, and answers with the line when each is.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from engine import raster
from engine.compress.cells import split_cells
from engine.compress.hvq import group_means
from engine.formats.ply.gaussians import read_ply, write_ply
from engine.formats.sog.codebook import learn_codebook
from engine.formats.sog.palette import learn_palette
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.numerics.image_metrics import ssim
from engine.numerics.resampling import remap
from engine.numerics.similarity import transform_model
from engine.numerics.tables import look_up
from engine.pictures.alignment.planar import align_image
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.keypoint_cameras import MatchedKeypoints, keypoints_of
from engine.pictures.camera.picture_edges import PictureEdges
from engine.pictures.camera.pose_refinement import refine_level
from engine.pictures.camera.view_search import search_views
from engine.pictures.camera.voted_views import agreement_of_views
from engine.pictures.jpeg.coded_blocks import find_quality
from engine.pictures.landmarks.keypoints import luma
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.records.reference import decode_reference, encode_reference
from engine.registration.mixtures import Parts, Wholes
from engine.registration.registration_search import register
from engine.registration.sketch import SuspectIndex, make_sketch
from engine.watermark.code_shares import combined
from engine.watermark.grain import ATTRIBUTES, Grain, roughen
from engine.watermark.grain_evidence import gather_grain_evidence
from engine.watermark.grain_pictures import GrainView
from engine.watermark.image_evidence import PictureEvidence

Work = Literal["embed", "model", "pictures", "main", "everything"]
"""Embedding; verifying a model; verifying pictures; these three; and with them discs."""


@dataclass(frozen=True)
class Step:
    """Kernels that are compiled together."""

    run: Callable[[], object]
    seconds: float  # of one core, to compile them (EPYC of 2022, after the steps before): a weight, and an estimate
    works: tuple[Work, ...]
    after: tuple[str, ...] = ()  # steps with some of the same kernels: theirs are then loaded, not compiled twice


def steps_of(work: Work) -> dict[str, Step]:
    """What some work needs, in an order in which it can be made ready."""
    return {
        name: step
        for name, step in STEPS.items()
        if work == "everything" or work in step.works or (work == "main" and step.works)
    }


def _embedding() -> None:
    labels = split_cells(np.eye(8, 6, dtype=np.float32), np.ones(8), 4)
    group_means(np.eye(8, 6, dtype=np.float32), labels, np.ones(8))
    _roughen()
    learn_palette(np.arange(48.0, dtype=np.float32).reshape(16, 3), 4)
    learn_codebook(np.arange(600.0), levels=4)
    picture = np.eye(16, dtype=np.float32)
    ssim(picture, picture)


def _roughen() -> None:
    ones = np.ones((8, 4), dtype=np.float32)
    model = GaussianModel(ones[:, :3], ones[:, :3], ones, ones[:, 0], ones[:, None, :3])
    roughen(model, Grain(0.1, 0.1), np.ones((8, ATTRIBUTES), dtype=np.float32))


def _registration() -> None:
    rng = np.random.default_rng(0)
    n = 600
    quats = rng.standard_normal((n, 4))
    model = GaussianModel(
        rng.standard_normal((n, 3), np.float32),
        rng.uniform(-5, -3, (n, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.standard_normal(n, np.float32),
        rng.standard_normal((n, 1, 3), np.float32),
    )
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    moved = transform_model(model, 1.5, turn, np.ones(3)).take(rng.permutation(n))
    for suspect in (model.take(rng.permutation(n)), moved, moved.take(np.arange(n // 2))):
        found = register(model, suspect)
        gather_grain_evidence(Grain(0.1, 0.1), model, suspect, found.similarity, found.matches, found.match_quality)
    Wholes(moved).find(Parts.of(model), found.similarity)
    SuspectIndex(moved).resemblance(make_sketch(model))
    combined(np.zeros(1, np.int64), np.zeros(1, np.int64), np.ones(1), np.ones((1, 3)), 1)


def _files() -> None:
    ones = np.ones((8, 4), dtype=np.float32)
    model = GaussianModel(ones[:, :3], ones[:, :3], ones, ones[:, 0], np.ones((8, 4, 3), np.float32))
    arrays = encode_reference(model)
    for array in arrays.values():
        array.flags.writeable = False  # as a record's are
    decode_reference(arrays)
    read_ply(b"".join(write_ply(model)), file="")


def _warps() -> None:
    rng = np.random.default_rng(0)
    picture = np.kron(rng.random((12, 12, 3)), np.ones((8, 8, 1))).astype(np.float32)
    align_image(picture, picture[3:, 5:])
    remap(picture, np.zeros((8, 8, 2)))
    look_up(luma(picture), 0.0, 1.0, np.zeros(2))
    find_quality((np.round(200.0 * picture + 20.0) / 255.0).astype(np.float32))
    chips = np.ones(6, np.float32)
    PictureEvidence(((6, 3),), chips, chips, chips, chips, chips, ()).by_scatter()


def _alignment() -> None:
    rng, n = np.random.default_rng(0), 300
    centers, levels = (rng.uniform(-1.0, 1.0, shape).astype(np.float32) for shape in ((n, 3), (n, 1, 3)))
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (n, 1))
    model = GaussianModel(centers, np.full((n, 3), -2.0, np.float32), quats, np.full(n, 3.0, np.float32), levels)
    camera = look_at((0.0, 0.0, -4.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 100.0, 96, 96)
    seen = np.clip(raster.render(model, camera), 0.0, 1.0)
    # The parts of `find_camera`: whole, it would look for this picture everywhere, for three seconds.
    MatchedKeypoints.of(keypoints_of(luma(seen)), make_landmarks(model, [camera]), (96, 96)).guided(camera)
    search_views(FarViews(model, [camera]).views, PictureEdges.of(seen), 1)
    agreement_of_views(np.zeros(2, np.int64), 9.0 * np.eye(2), 9.0 * np.eye(2), np.ones(2))
    refine_level(model, luma(seen), camera, 1, 1.0)
    _roughen()
    drawn = raster.draw(model, camera)
    GrainView(drawn, Grain(0.1, 0.1)).pull(drawn.view, seen)


def _colors() -> None:
    model, _ = _scene()
    raster.sh_colors(model.sh, model.means, np.zeros(3))


def _pictures() -> None:
    model, camera = _scene()
    raster.render(model, camera)
    raster.render_depth(model, camera)
    raster.prepare_view(model, camera).render(_one_channel(model))


def _all_gradients() -> None:
    rendering = raster.draw(*_scene())
    raster.backward(rendering, rendering.image)


def _discs() -> None:
    model, camera = _scene()
    view = raster.prepare_view(model, camera, raster.RasterSettings(kernel="disc"))
    view.render(_one_channel(model))
    view.render(np.zeros((len(model), 3), dtype=np.float32))
    _pull_back(view)


def _one_channel(model: GaussianModel) -> Float32:
    return np.zeros((len(model), 1), dtype=np.float32)


def _pull_back(view: raster.View) -> None:
    for channels in (1, 3):
        view.backward_colors(np.zeros((view.camera.height, view.camera.width, channels), dtype=np.float32))
    view.weights()


def _scene() -> tuple[GaussianModel, Camera]:
    """16 Gaussians in front of a camera of 16 x 16 pixels."""
    rng = np.random.default_rng(0)

    def random(scale: float, *shape: int) -> Float32:
        return rng.normal(0.0, scale, shape).astype(np.float32)

    model = GaussianModel(
        random(0.5, 16, 3), random(0.1, 16, 3) - 2, random(1.0, 16, 4), random(1.0, 16), random(0.3, 16, 4, 3)
    )
    return model, look_at((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 16.0, 16, 16)


STEPS: dict[str, Step] = {
    "files": Step(_files, 2.5, ("embed", "model", "pictures")),
    "registration": Step(_registration, 6.5, ("model",)),
    "geometry": Step(lambda: raster.prepare_view(*_scene()), 3.5, ("embed", "pictures")),
    "cells": Step(_embedding, 3.5, ("embed",)),
    "colors": Step(_colors, 1.5, ("embed", "pictures")),
    "pictures": Step(_pictures, 4.0, ("embed", "pictures"), ("geometry", "colors")),
    "color gradients": Step(
        lambda: _pull_back(raster.prepare_view(*_scene())), 4.0, ("embed", "pictures"), ("geometry",)
    ),
    "all gradients": Step(_all_gradients, 4.5, ("pictures",), ("pictures", "color gradients")),
    "warps": Step(_warps, 5.0, ("pictures",)),
    "alignment": Step(_alignment, 5.0, ("pictures",), ("pictures", "registration", "cells", "all gradients")),
    "discs": Step(_discs, 1.5, (), ("pictures", "color gradients")),
}

if __name__ == "__main__":
    for line in sys.stdin:
        STEPS[line.strip()].run()
        sys.stdout.write(line)
        sys.stdout.flush()
