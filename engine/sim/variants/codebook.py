"""Models compressed by k-means codebooks (Compact3D / CompGS), marked in their own colour codebook.

Navaneet, Pourahmadi Meibodi, Abbasi Koohpayegani and Pirsiavash, "CompGS: Smaller and Faster Gaussian Splatting with
Vector Quantization" (ECCV 2024): each group of attributes has a codebook, a Gaussian keeps one index a group.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.compress.hvq import HvqConfig, learn_residual_stage
from engine.errors import InputError
from engine.formats.repairs import clean
from engine.model import Float32, GaussianModel, Int32
from engine.pipeline.embedding import Embedding, embed
from engine.pipeline.variant import Variant
from engine.watermark.keys import OwnerKey

__all__ = ["GROUPS", "CodebookModel", "embed_codebook", "make_codebook"]

GROUPS = ("xyz", "dc", "sh", "scale", "rot")
"""Groups of attributes as the public code names them: centres, DC, the other SH coefficients (coefficient-major),
log scales, quaternions. Opacity is never quantised."""

CODES = {"dc": 4096, "sh": 4096, "scale": 4096, "rot": 4096}
"""Codes of each group where `make_codebook` is not told: the smaller of the paper's settings."""


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


def make_codebook(model: GaussianModel, codes: Mapping[str, int] | None = None, *, seed: int = 0) -> CodebookModel:
    """Quantise a trained model by k-means, each group to so many `codes` (`CODES` by default); others stay plain.

    The published system learns its codebooks while the model trains; here a finished model is quantised, which costs
    more quality. Results must say so.
    """
    codes = dict(CODES if codes is None else codes)
    if not codes:
        raise InputError("no group was given to quantise")
    for name, count in codes.items():
        if name not in GROUPS or count < 1:
            raise InputError(f"cannot quantise {name!r} to {count} codes; there are {', '.join(GROUPS)}")
    flat = model.sh.reshape(len(model), -1)
    groups = {
        "xyz": model.means,
        "dc": flat[:, :3],
        "sh": flat[:, 3:],
        "scale": model.log_scales,
        "rot": model.quats * np.where(model.quats[:, :1] < 0, np.float32(-1), np.float32(1)),
    }
    plain = {"opacity": model.opacity_logits[:, None]}
    centers, indices = {}, {}
    for name, values in groups.items():
        if name not in codes or values.shape[1] == 0:
            plain[name] = np.ascontiguousarray(values)
            continue
        stage = learn_residual_stage(np.ascontiguousarray(values), np.ones(len(model)), codes[name], HvqConfig(), seed)
        centers[name], indices[name] = stage.codebook, stage.labels
    bits = max((len(book) - 1).bit_length() for book in centers.values())
    return CodebookModel(plain, centers, indices, max(bits, 1))


def embed_codebook(compressed: CodebookModel, key: OwnerKey, **request: Any) -> tuple[CodebookModel, Embedding]:
    """Mark a model in its own colour codebook: its entries are the mark's code vectors.

    Centres and sizes carry the grain where they are plain; a codebook of them would need an entry a Gaussian.

    The `request` is that of `engine.pipeline.embedding.embed`, whose errors are raised, too; ``original_sha256`` must
    be there. The marked model has as many codes and the same indices: a file of the same size. InputError if the
    colours have no codebook.
    """
    if "dc" not in compressed.centers:
        raise InputError("this model's colours are not quantised: mark it as a plain model")
    model, labels = compressed.decode(), compressed.indices["dc"]
    own = Variant(labels=labels, free_centers="xyz" in compressed.plain, free_sizes="scale" in compressed.plain)
    result = embed(model, key, variant=own, **request)
    used, member = np.unique(labels, return_index=True)  # all members of a code are displaced alike
    codes = compressed.centers["dc"].copy()  # (M, 3)
    codes[used] = result.model.sh[member, 0]
    free = {
        name: values
        for name, values in (("xyz", result.model.means), ("scale", result.model.log_scales))
        if name in compressed.plain
    }
    return replace(compressed.with_codes("dc", codes), plain={**compressed.plain, **free}), result
