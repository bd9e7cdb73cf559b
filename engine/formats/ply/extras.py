"""Vertex properties of a PLY beyond those of a Gaussian: motion, filters, and unknown ones.

Names as public code writes them: Spacetime Gaussians (``trbf_*``, ``motion_*``, ``omega_*``, ``f_t_*``), 4-D Gaussians
(Yang et al., ICLR 2024, and those built on it: ``t``, ``mu_t``, ``scale_t*``, ``t_scale``, ``rot_l_*``, ``rot_r_*``),
FreeTimeGS and viewers of its kind (``vx``, ``velocity_*``, ``time``, ``duration``), tracks (``delta_x_t0``).
"""

import re
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from engine.errors import UnsupportedFormatError
from engine.formats.modes import mode_of_comments
from engine.formats.ply.header import MAX_HEADER_BYTES, TYPE_NAMES, Element, Header
from engine.formats.repairs import Repair
from engine.model import Carried, Float32

FILTER = "filter_3D"
"""Deviation of Mip-Splatting's 3D smoothing filter, scene units."""

GAUSSIAN = {"opacity", "scale_0", "rot_0"}  # a point cloud has none of them

_HEADER_ROOM = 4096
"""Bytes by which the header that is written may be longer than the one that was read."""

_MOTION = re.compile(
    r"(trbf|motion|omega|velocity|vel|delta|rot_l|rot_r|rotation_r)_\w+|f_t_\d+"
    r"|t|mu_t|time|duration|t_scale|(scale|scaling)_t(_\d+)?|v[xyz]"
)
"""Of properties that say where, how large or how opaque a Gaussian is at some time."""

_DRAWN = re.compile(
    r"(f_|features?_)?(asg|sg|sb|sv|latent|appearance|brdf|albedo|base_color|roughness|metallic|refl\w*|specular\w*"
    r"|diffuse|incidents?|visibility|tex|texture)_|(roughness|metallic|metalness|reflect|specular)\w*$|(beta|shape"
    r"|nu_degree|nu)$"
)
"""Spherical Gaussians, anisotropic ones, betas and Voronoi cells; latent colors; materials; textures; other kernels."""


def refuse_motion(vertex: Element, *, file: str) -> None:
    """UnsupportedFormatError naming the properties if these Gaussians move: nothing of it has a place in a model."""
    if "binding_0" in vertex.names:  # GaussianAvatars, SurFhead
        message = "the Gaussians ride on a mesh, each stored in the frame of a triangle: export a moment as plain ones"
        raise UnsupportedFormatError(message, file=file, element="vertex", prop="binding_0")
    textured = {"s", "t"} <= vertex.names  # coordinates of a texture, as Blender writes them
    moving = [p.name for p in vertex.properties if _MOTION.fullmatch(p.name) and not (textured and p.name == "t")]
    if moving:
        lite = ": a Spacetime clip, which embed and verify take as what it is" if "trbf_center" in moving else ""
        message = f"the Gaussians move{lite}; as a model that stands still it would lose {named(moving)}"
        raise UnsupportedFormatError(message, file=file, element="vertex", prop=moving[0])


def refuse_elements(header: Header, *, file: str) -> None:
    """UnsupportedFormatError if several elements have the properties of a Gaussian, or the vertices are indices into
    codebooks (Papantonakis et al. 2024, "V2" of INRIA)."""
    several = [element.name for element in header.elements if element.names >= GAUSSIAN]
    if len(several) > 1:  # Street Gaussians: those of a thing that moves stand in its own frame
        message = f"holds Gaussians in {len(several)} elements ({named(several)}), which may move against each other:"
        raise UnsupportedFormatError(message + " export each as a file of its own", file=file, element=several[1])
    if header.element("codebook_centers") is not None:
        message = "the Gaussians are indices into codebooks; export plain float properties"
        raise UnsupportedFormatError(message, file=file, element="codebook_centers")


def fuse_filter(log_scales: Float32, logits: Float32, width: npt.NDArray[np.float32]) -> tuple[Float32, Float32]:
    """Log scales (N, 3) and opacity logits (N,) with the 3D filter (N,) folded in, as Mip-Splatting exports them.

    Each variance grows by the filter's, each opacity falls by the root of the ratio of determinants (Yu et al., CVPR
    2024, equation 9; ``create_fused_ply`` of its code). Anything that is no number stays to be found.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        before = 2.0 * log_scales.astype(np.float64)  # log variances
        after = np.logaddexp(before, 2.0 * np.log(np.abs(width.astype(np.float64)))[:, None])
        log_opacity = -np.logaddexp(0.0, -logits.astype(np.float64)) + 0.5 * (before - after).sum(axis=1)
        faded = log_opacity - np.log(-np.expm1(log_opacity))
        return (0.5 * after).astype(np.float32), np.where(width == 0, logits, faded).astype(np.float32)


def named(names: Iterable[str]) -> str:
    """Names for a message: the first eight, made harmless."""
    listed = list(names)
    return ", ".join(repr(name[:40]) for name in listed[:8]) + (", ..." if len(listed) > 8 else "")


def carried_by(
    header: Header, records: npt.NDArray[np.void], names: list[str], rows: npt.NDArray[np.int64] | None
) -> Carried | None:
    """These properties of the rows of a file that are Gaussians, all where `rows` is None, and its comments; None where
    there is neither."""
    comments = tuple(each for each in header.comments if mode_of_comments([each]) is None)
    if not (names or comments) or _is_long(header):
        return None
    kinds = [(name, records.dtype[name].newbyteorder("<")) for name in names]
    count = len(records) if rows is None else len(rows)
    columns = np.empty(count, kinds)
    for name in names:
        columns[name] = records[name] if rows is None else records[name][rows]
    return Carried(columns, comments)


def lines_of(carried: Carried | None) -> tuple[list[str], list[str]]:
    """Lines of a header: the comments, and the properties."""
    if carried is None:
        return [], []
    kinds = carried.columns.dtype
    properties = [f"property {TYPE_NAMES[kinds[name].str[1:]]} {name}" for name in carried.names]
    return [f"comment {text}" for text in carried.comments], properties


def ignored(what: str, names: list[str]) -> Repair:
    """The note on properties, which a PLY keeps, or elements that no Gaussian has."""
    done = "are kept in .ply alone" if what == "properties" else "were ignored"
    return Repair(f"extra_{what}", len(names), f"{what} that no Gaussian has {done}: {named(names)}")


def carrying(header: Header, names: list[str]) -> list[Repair]:
    """Notes on what `carried_by` carries of these properties and the comments, or cannot."""
    if _is_long(header):
        text = f"comments and properties that no Gaussian has were dropped: the header has {header.size:,} bytes"
        return [Repair("header_too_long", 1, text)]
    drawn = [name for name in names if _DRAWN.match(name)]
    text = (
        f"{named(drawn)} are colors, materials or kernels beyond spherical harmonics and Gaussians, which only their"
        " trainer's viewer draws: left out of every picture here and of what is said of the look; no mark is in them"
    )
    notes = [Repair("drawn_elsewhere", len(drawn), text)] if drawn else []
    return [ignored("properties", names), *notes] if names else []


def _is_long(header: Header) -> bool:
    return header.size > MAX_HEADER_BYTES - _HEADER_ROOM
