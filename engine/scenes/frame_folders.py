"""A dynamic scene as one exported model per moment: how deformation-network models (4DGS) come out of their tools.

Wu et al., "4D Gaussian Splatting for Real-Time Dynamic Scene Rendering" (CVPR 2024) deform the positions, scales and
rotations of one set of Gaussians; colours and opacities stay as they are in its published settings.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.formats import read_model, write_model
from engine.model import Float32, GaussianModel
from engine.numerics.similarity import quaternion_to_rotation

__all__ = ["FrameSequence", "frame_files", "read_frames", "write_frames"]

COLOR_TOLERANCE = 1e-3
"""Largest difference of a colour coefficient between frames: more is a scene whose colours change with time."""


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """T exported models of the same N Gaussians, row by row, with equal colours, and the moment of each, ascending."""

    frames: Sequence[GaussianModel]
    times: Sequence[float]

    def __post_init__(self) -> None:
        if not self.frames or len(self.frames) != len(self.times):
            raise InputError(f"{len(self.frames)} frames but {len(self.times)} times")
        if not np.isfinite(self.times).all() or (np.diff(self.times) <= 0).any():
            raise InputError("the times of frames must be finite and ascending")
        first = self.frames[0]
        for number, frame in enumerate(self.frames):
            if len(frame) != len(first) or frame.sh.shape != first.sh.shape:
                raise InputError(
                    f"frame {number} has {len(frame)} Gaussians of degree {frame.sh_degree}, frame 0 has "
                    f"{len(first)} of degree {first.sh_degree}: a sequence needs the same ones in every frame"
                )
            gap = float(np.abs(frame.sh - first.sh).max())
            if gap > COLOR_TOLERANCE:
                raise InputError(f"the colours of frame {number} differ by {gap:g} from those of frame 0")

    def __len__(self) -> int:
        return len(self.frames[0])

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment."""
        return float(self.times[0]), float(self.times[-1])

    def at(self, time: float, displaced: GaussianModel | None = None) -> GaussianModel:
        """The frame nearest in time, with the colours of the first.

        As if `displaced` were the canonical model, where given: centres move along with their Gaussian's axes.
        """
        nearest = int(np.abs(np.asarray(self.times) - time).argmin())
        frame = self.frames[nearest].with_(sh=self.frames[0].sh)
        return frame if displaced is None else _displace(frame, self.canonical(), displaced)

    def canonical(self) -> GaussianModel:
        """The frame in the middle of the sequence."""
        return self.at(float(self.times[len(self.times) // 2]))

    def persistence(self) -> Float32:
        """(N,) mean opacity over the frames against the largest one, 0 to 1."""
        opacities = np.stack([frame.opacities for frame in self.frames])
        mean: Float32 = opacities.mean(axis=0) / np.maximum(opacities.max(axis=0), 1e-12)
        return mean

    def displaced(self, canonical: GaussianModel) -> FrameSequence:
        """A copy of which every frame is displaced as this model is against the canonical one."""
        return FrameSequence([self.at(time, canonical) for time in self.times], self.times)

    def digest(self) -> str:
        """SHA-256 over times and all arrays of all frames, hexadecimal."""
        whole = hashlib.sha256(b"frames 1" + np.asarray(self.times, dtype="<f8").tobytes())
        for frame in self.frames:
            for array in (frame.means, frame.log_scales, frame.quats, frame.opacity_logits, frame.sh):
                whole.update(np.ascontiguousarray(array, dtype="<f4").tobytes())
        return whole.hexdigest()


def _displace(frame: GaussianModel, before: GaussianModel, after: GaussianModel) -> GaussianModel:
    """The frame with every centre and size moved as from one model to another, along its own axes, in its own sizes."""
    shift = (after.means - before.means)[:, :, None].astype(np.float64)  # (N, 3, 1)
    own = np.swapaxes(quaternion_to_rotation(before.quats), 1, 2) @ shift  # along the Gaussian's axes
    own *= np.exp((frame.log_scales - before.log_scales).astype(np.float64))[:, :, None]
    moved = (quaternion_to_rotation(frame.quats) @ own)[:, :, 0]
    return frame.with_(
        means=(frame.means + moved).astype(np.float32),
        log_scales=frame.log_scales + (after.log_scales - before.log_scales),
        sh=after.sh,
    )


def frame_files(folder: str | os.PathLike[str]) -> list[Path]:
    """The files of a folder of frames in the order of their moments: its ``.ply`` files, by name."""
    return sorted(Path(folder).glob("*.ply"))


def write_frames(sequence: FrameSequence, folder: str | os.PathLike[str]) -> int:
    """Write every frame as ``time_00000.ply`` and so on, as 4DGS exports them, into a folder; returns their bytes."""
    base = Path(folder)
    return sum(write_model(frame, base / f"time_{k:05d}.ply") for k, frame in enumerate(sequence.frames))


def read_frames(folder: str | os.PathLike[str]) -> FrameSequence:
    """Read a folder of exported models, its ``.ply`` files in the order of their names.

    Their moments are spread evenly from 0 to 1. InputError if there are no files, or they do not belong
    together; FormatError if one cannot be read.
    """
    if not Path(folder).is_dir():
        raise InputError(f"{folder}: is no folder")
    paths = frame_files(folder)
    if not paths:
        raise InputError(f"{folder}: holds no .ply files")
    return FrameSequence([read_model(path).model for path in paths], np.linspace(0.0, 1.0, len(paths)).tolist())
