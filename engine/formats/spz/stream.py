"""SPZ (Niantic): versions 1 to 4 are read, 3 is written.

Format: nianticlabs/spz, README and src/cc/load-spz.cc.
"""

import numpy as np

from engine.errors import InputError
from engine.formats import modes
from engine.formats.ply.extras import named
from engine.formats.repairs import ALPHA_LOGITS, Repair, clean, degree_dropped
from engine.formats.spz import attributes
from engine.formats.spz.container import ANTIALIASED, Header, pack, unpack
from engine.formats.spz.frames import SPECIFICATION, frame_change, other_extensions
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model


def read_spz(data: bytes, *, file: str, frame: str = "auto") -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read an SPZ file, into PLY's axes.

    The specification's axes have y and z negated against PLY, yet half of the tools write PLY's straight in and say
    nothing. A `frame` of "auto" believes the file's SPZ_ADOBE_coordinate_system extension, and the specification where
    there is none; "spec" and "ply" overrule the file.

    Harmonics of degree 4 are read to degree 3, and reported. UnsupportedFormatError for another version, harmonics
    beyond degree 4, or a tree of levels of detail; FormatError if the bytes are not those that the header implies;
    InputError if `frame` is none of the three.
    """
    payload = unpack(data, file=file)
    header = payload.header
    change = frame_change(frame, payload.extensions, file=file)
    positions, alphas, colors, scales, rotations, rest = payload.sections
    if header.version == 1:
        means = np.frombuffer(positions, dtype="<f2").astype(np.float32).reshape(-1, 3)
    else:
        means = attributes.decode_positions(positions, header.fractional_bits)
    decode = attributes.decode_first_three if header.version < 3 else attributes.decode_smallest_three
    quats = decode(rotations)
    sh = np.empty((header.count, (min(header.sh_degree, 3) + 1) ** 2, 3), dtype=np.float32)
    sh[:, 0] = attributes.look_up(attributes.COLORS, colors).reshape(-1, 3)
    attributes.decode_sh(rest, sh)
    change.apply_signs(means, quats, sh)
    log_scales = attributes.look_up(attributes.LOG_SCALES, scales).reshape(-1, 3)
    logits = attributes.look_up(ALPHA_LOGITS, alphas)
    model, repairs = clean(means, log_scales, quats, logits, sh, file=file, element="points")
    if header.sh_degree > 3:
        repairs = (degree_dropped(header.sh_degree, header.count), *repairs)
    if others := other_extensions(payload.extensions, file=file):
        text = f"extension records of {named(others)} were ignored: nothing of a Gaussian"
        repairs = (Repair("extra_extensions", len(others), text), *repairs)
    if change.turn is not None:
        model = transform_model(model, 1.0, change.turn, np.zeros(3))
    return modes.with_mode(model, modes.ANTIALIASED if header.flags & ANTIALIASED else None), repairs


def write_spz(model: GaussianModel) -> bytes:
    """Write an SPZ file of version 3 (gzip), which everything reads, in the specification's axes (right, up, back).

    Errors at most, within the ranges: half a step in a centre (1/4096, or what the scene's size asks for), 1/32 in a
    log scale in [-10, 5.94], 1/510 in an opacity, 1/76.5 in a DC coefficient in [-3.33, 3.33], 2^-8 in another one in
    [-1, 127/128], 0.0007 in each of the three smaller components of a quaternion.

    InputError if a centre does not fit into 24 bits.
    """
    places = attributes.choose_fractional_bits(model.means)
    reach = float(np.abs(model.means).max(initial=0.0))
    if np.rint(reach * 2.0**places) > (1 << 23) - 1:
        raise InputError(f"a coordinate of {reach:g} does not fit into 24 bits")
    change = SPECIFICATION  # its own inverse
    quats = model.quats.copy()
    quats[:, 1:] *= change.quaternion_signs
    means = model.means * change.signs.astype(np.float32)
    signs = change.coefficient_signs(model.sh.shape[1])
    arrays = (means, model.log_scales, quats, model.opacities, model.sh)
    flags = ANTIALIASED if modes.mode_of(model) == modes.ANTIALIASED else 0
    return pack(Header(3, len(model), model.sh_degree, places, flags), attributes.encode_all(arrays, places, signs))
