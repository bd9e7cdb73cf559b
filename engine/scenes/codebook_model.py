"""Models compressed by k-means codebooks (Compact3D / CompGS); `scene_marking` marks them.

Navaneet, Pourahmadi Meibodi, Abbasi Koohpayegani and Pirsiavash, "CompGS: Smaller and Faster Gaussian Splatting with
Vector Quantization" (ECCV 2024): each group of attributes has a codebook, a Gaussian keeps one index a group.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.formats.repairs import clean
from engine.model import Float32, GaussianModel, Int32

__all__ = ["GROUPS", "CodebookModel"]

GROUPS = ("xyz", "dc", "sh", "scale", "rot")
"""Groups of attributes as the public code names them: centres, DC, the other SH coefficients (coefficient-major),
log scales, quaternions. Opacity is never quantised."""


@dataclass(frozen=True, eq=False)
class CodebookModel:
    """N Gaussians of which some attributes are codebook entries."""

    plain: Mapping[str, Float32]  # the groups that are not quantised, and "opacity" (N, 1) as logits
    centers: Mapping[str, Float32]  # codebook of each quantised group, in the order of the file
    indices: Mapping[str, Int32]  # entry of each Gaussian in each codebook
    index_bits: int  # bits of an index in the file

    def __post_init__(self) -> None:
        if "opacity" not in self.plain or set(self.centers) != set(self.indices):
            raise InputError("a codebook model needs its opacities, and indices for each codebook")
        count = len(self)
        for name in GROUPS:
            if (name in self.plain) == (name in self.centers) and name != "sh":
                raise InputError(f"{name!r} must be either plain or quantised")
        for name, values in {**self.plain, **self.centers}.items():
            width = {"xyz": 3, "dc": 3, "scale": 3, "rot": 4, "opacity": 1}.get(name)
            if name not in (*GROUPS, "opacity") or values.ndim != 2 or width not in (None, values.shape[1]):
                raise InputError(f"{name!r} of a codebook model cannot have shape {values.shape}")
        for name, index in self.indices.items():
            codes = len(self.centers[name])
            if index.shape != (count,) or index.min(initial=0) < 0 or index.max(initial=0) >= codes:
                raise InputError(f"indices of {name!r} do not fit {count} Gaussians and {codes} codes")
            if (codes - 1).bit_length() > self.index_bits:
                raise InputError(f"{codes} codes of {name!r} do not fit {self.index_bits} bits")

    def __len__(self) -> int:
        return len(self.plain["opacity"])

    def decode(self) -> GaussianModel:
        """The Gaussians, every index looked up; quaternions of unit length, absurd scales and opacities clamped."""
        xyz, dc, rest, scale, rot = (self._group(name) for name in GROUPS)
        sh = np.concatenate([dc, rest], axis=1).reshape(len(self), -1, 3)  # (N, K, 3)
        return clean(xyz, scale, rot, self.plain["opacity"][:, 0], sh, file="codebook model")[0]

    def with_codes(self, name: str, codes: Float32) -> CodebookModel:
        """A copy with another codebook of the same size for one group."""
        if name not in self.centers or codes.shape != self.centers[name].shape:
            raise InputError(f"the codebook of {name!r} cannot have shape {codes.shape}")
        return replace(self, centers={**self.centers, name: codes.astype(np.float32)})

    def _group(self, name: str) -> Float32:
        if name in self.centers:
            return self.centers[name][self.indices[name]]
        return self.plain.get(name, np.zeros((len(self), 0), dtype=np.float32))
