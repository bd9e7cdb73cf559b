"""Tuned constants of the watermark, a frozen config for each stage (DESIGN 4.5, 4.8 and 4.9).

What claims are held to (`statistics`, `rates`) and what records fix stays where it is defined: those are terms, not
tuning. z values and standard deviations have no unit.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class CellsConfig:
    """Secret cells and what they hide: how well colors can be guessed (`secret_cells`, `unpredictability`)."""

    tilt: float = 0.35  # of each cut away from the widest feature, standard deviation against 1 along it
    slide: float = 0.06  # of a cut from the middle, either way, share of the node's weight
    jitter: float = 0.3  # half width of the keyed factor on each chip's amplitude, as a logarithm
    # Public cells nearest to a Gaussian's own, itself among them, to one of which it is dealt where borders are blurred
    blur: int = 8
    neighbors: int = 24  # code vectors from which a color is guessed, by a plane fitted to them
    around: int = 9  # code vectors, itself among them, over which misses are averaged: one may be guessed by luck
    ridge: float = 1e-3  # keeps planes through neighbors on a line from tilting without end


@dataclass(frozen=True)
class PlanningConfig:
    """Amplitudes and capacity (`layout`, `secret_cells`, `planning`)."""

    # Least amplitude of a carrier against a pure luma carrier. Chroma is subsampled in every screenshot, but on the
    # model itself all three carriers read equally well and three carriers hold three times the chips
    chroma_floor: float = 0.12
    # Size of a typical displacement, SH units (a mark at 47 dB moves code vectors by 0.01 to 0.05). Planned amplitudes
    # have this median, and no residual this small is treated as an outlier
    mark_scale: float = 0.02
    # Share of the Gaussians that may hold still. More means that the scene has few values, not that some were clipped
    most_still: float = 2.0 / 3.0
    mass_factor: float = 2.0  # of a value's Gaussians, in those of the values around it, from which it is a mass
    # Noise of each color channel (standard deviation, range 1) for which z is predicted: one picture, badly compressed
    reference_noise: float = 0.05
    # z of a claim, in that of this noise, from our own render at JPEG 10, profile `fast`. Measured on five scenes
    # (guitar, plant, playbot_lod2, st_peter, tarot), whose medians came to 0.44 to 0.71
    claimed_render: float = 0.60
    reference_pixels: int = 800 * 800  # pixels of that picture: suspects do not depend on the size of the key views
    # Least predicted z of a bit that the planner accepts: about one wrong bit in a hundred on that one bad picture;
    # several pictures, a better one, or the model itself read all of them
    bit_z: float = 2.3
    chips_per_bit: int = 16  # fewest: losing most of the model still leaves each bit some
    grain_chips_per_bit: int = 64  # fewest of the grain, lost by Gaussians: a tenth of the model reads nearly all bits
    # Range of how badly a color is guessed, relative to the usual, within which amplitudes follow it
    surprise: tuple[float, float] = (0.2, 4.0)
    # Most that a carrier may show against how badly colors are guessed along it, in multiples of what the first one
    # (nearly luma) shows: gray stone hardly varies in chroma, where a mark would be all that does. Five scenes: 2 hides
    # as well as 1, and lowers no z
    hidden: float = 2.0


@dataclass(frozen=True)
class LatticeConfig:
    """Steps of a file's numbers (`lattice`)."""

    few: float = 1.0 / 3.0  # distinct values, in rows, up to which they are a table
    finest: float = 2.0**-21  # step, in the largest value, below which floats themselves are no coarser
    off: float = 0.05  # mean distance of values from their lattice by rounding, steps: by chance it is a quarter
    least_rows: int = 64  # below which nothing is found
    # Rows that show whether steps change between rows: a quarter of a chunk of compressed PLY; and enough for 16 bits
    windows: tuple[int, ...] = (64, 1024)
    probes: int = 24  # such windows that are looked at first,
    glance: int = 6  # each sixth before the others: of free values none lies on even steps
    least_probes: float = 0.15  # share of the probes that must: others lie across a change
    # Share of a step from which a displacement is rounded, up or down; below, the value stays. A rare whole step says
    # little of a small displacement, and shows. Of colors, code vectors average over many
    least_move_geometry: float = 0.25
    least_move_color: float = 0.05


@dataclass(frozen=True)
class GrainConfig:
    """The grain (`grain`, `grain_evidence`)."""

    # Share of the middle axis that a thin axis counts as, at least. What lies across a flat Gaussian is seen edge-on
    # only: 0.3 shows no more than 0 does (three scenes), and holds where formats round a sheet's thickness away
    flat: float = 0.3
    thinnest: float = 1e-5  # of the middle scale; below it a Gaussian is a disc, whose thickness no file keeps
    # Cosine between an axis and its partner's from which the axes show which scale is which; below, their order does
    sure: float = 0.8
    lost: float = 4.0  # deviations beyond which a difference counts as a wrong match and is left out


@dataclass(frozen=True)
class EvidenceConfig:
    """Evidence of pictures and models (`image_evidence`, `model_evidence`, `code_shares`, `picture_agreement`)."""

    rows: int = 1 << 16  # chips summed together
    # Medians of its carrier's at which evidence of one chip saturates in pictures: a few code vectors that fill the
    # picture (fog, a wall) would otherwise outweigh thousands
    clip: float = 8.0
    alike: int = 16  # classes of about equally many chips of like response, whose scatter is measured together
    sample: int = 1 << 16  # chips of one kind that show where the classes end
    affine_sample: int = 30_000  # Gaussians from which the change of colors is fitted
    # And in models. What an attacker adds is spread unevenly (a second mark, a repainted patch, noise on a few
    # members); linear weights would let the few largest drown the rest
    saturation: float = 2.0
    passes: int = 2  # of residual compensation over the stages (Eq 11); the second changes z by under a per cent
    blend: float = 4.0  # members that the whole scene's spread is worth: a few members say little about their own
    least_pictures: int = 3  # that are compared: of two that disagree, either may be the wrong one
    # Standard deviations of chance by which a picture must be expected to agree with the others before it is judged
    expected_agreement: float = 6.0
    # Share of what is expected that a picture of the mark comes to at least: with one in four that shows another mark
    # they come to 1 and more, that one to 0.1 at most
    agrees: float = 0.3
    # Bytes of single pictures' evidence that may be kept to compare them: 38 pictures of a hundred thousand Gaussians
    # with a grain. Beyond that they are summed as they come, and none is left out
    most_kept: int = 1 << 30


@dataclass(frozen=True)
class PowerConfig:
    """Reliability of bits and power of tests (`statistics`, `power`)."""

    lost_bit: float = 0.05  # prior of a bit whose signal was lost where the others kept theirs
    rows: int = 1 << 15  # chips summed together: they stay in the cache; 60 million at once would take gigabytes
    # Sizes of the mark at which the change of one chip is counted, where it is larger: a wrong match, or one that a
    # thief pushed until its weight fell to nothing
    far: float = 4.0


@dataclass(frozen=True)
class RegionsConfig:
    """Regions of the asset (`regions`, `region_search`)."""

    codes: int = 12  # code vectors of the smallest region, 36 chips of the tint: 4,096 of them give 256 regions of 16
    # Chips, counted by their shares of the evidence, below which nothing is said of a region: what is shown of few
    # would give their secret signs away
    least_chips: float = 30.0
    # z that the mark is expected to give in a region by itself, or it is joined with its neighbor. The estimate is low
    # (what was measured, the mark too, counts as noise): an intact mark shows 1.4 to 2 times as much, and a discovery
    # among many takes 3.6 at 1 % and six tries
    enough: float = 4.0
    wide: float = 0.9  # share of a region's Gaussians within its radius
    faint: float = 0.02  # share of what pictures say that is left to the faintest leaves: they count as not seen
    present: float = 0.5  # share of a region's Gaussians that the suspect must hold for it to be called altered


@dataclass(frozen=True)
class PaperDecoderConfig:
    """The paper's decoder, with the paper's numbers (`paper_decoder`)."""

    lambda_freq: float = 0.1  # of Eq 11, as of Eq 7 (the paper's appendix)
    epsilon_steps: float = 3.0  # tolerance epsilon of Eq 10, in steps beta delta of the code vector


@dataclass(frozen=True)
class WatermarkConfig:
    """The stages of the watermark."""

    cells: CellsConfig = CellsConfig()
    planning: PlanningConfig = PlanningConfig()
    lattice: LatticeConfig = LatticeConfig()
    grain: GrainConfig = GrainConfig()
    evidence: EvidenceConfig = EvidenceConfig()
    power: PowerConfig = PowerConfig()
    regions: RegionsConfig = RegionsConfig()
    paper: PaperDecoderConfig = PaperDecoderConfig()


CONFIG = WatermarkConfig()
