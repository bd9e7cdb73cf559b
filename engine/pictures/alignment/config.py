"""Tuned constants of the alignment of pictures with renders, a frozen config for each stage (DESIGN 4.8).

Image values are 0..1; lengths are in pixels where no other unit is named.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanarConfig:
    """Motion in the plane of the picture (`planar`, `brightness_fit`)."""

    keypoints: int = 2000  # SIFT keypoints of an image
    ratio: float = 0.8  # Lowe's ratio of distances
    ransac_pixels: float = 3.0  # reprojection error of an inlier, pixels
    least_matches: int = 8  # inliers that a hypothesis of keypoints needs
    least_correlation: float = 0.4  # of the brightness of both images, below which there is no alignment
    sure_correlation: float = 0.98  # above which no further hypothesis is tried
    well_correlation: float = 0.95  # correlation below which it may be mirrored: rivals that look alike came to 0.92
    perspective_gain: float = 0.97  # a homography must lower the residual to this share of the similarity's
    snap_pixels: float = 0.06  # a smaller motion is none: the picture is used without resampling, pixels
    # So is one up to this, pixels, that does not lower the residual to `perspective_gain`: coarse JPEG makes such up
    snap_far: float = 0.3
    whole_pixels: float = 2.0  # a motion this near to a shift by whole pixels may be one: coarse JPEG makes up one
    margin: int = 3  # by which the mask is eroded, pixels
    suspicious: float = 0.005  # share of contradicting pixels above which brightness is predicted more carefully
    samples: int = 120_000  # pixels used on one level at most; those with the steepest gradients
    iterations: tuple[int, int, int, int] = (6, 6, 10, 12)  # at most, on levels 1, 2, 4 and 8
    clipped: float = 0.985  # brighter samples of the suspect say nothing about position
    least_samples: int = 60  # pixels below which nothing is fitted


@dataclass(frozen=True)
class FlowConfig:
    """Bent pictures (`local_flow`)."""

    opaque: float = 0.5  # opacity of the reference below which a pixel does not say where the model is
    # Blur of the windows in which correlation is measured and the flow is refined, pixels: with 5, the evidence of four
    # pictures stayed as it is or fell by up to 3 %
    around: float = 8.0
    fits: float = 0.9  # correlation of a neighborhood from which it fits
    well: float = 0.85  # share of the model that fits above which nothing is sought
    # Share of the model that must fit more at half size, by the rough flow, for more to be done: of 20 pictures that
    # need no bending 17 came to less, none of those that do
    better: float = 0.04
    telling: int = 256  # longer side of the half-sized picture below which `better` is skipped: the rest costs little
    clear: float = 0.06  # share of the model that must fit more than before in the end
    kept: float = 0.8  # correlation of a neighborhood below which it is masked after the warp
    consistent: float = 1.0  # difference of the flow forth and back, pixels of half the size
    median: int = 5  # side of the median that takes single wrong vectors out of the flow, pixels of half the size
    filled: float = 4.0  # blur by which the flow is filled in where the two do not agree, pixels
    rounds: int = 6  # of the refinement
    farthest: float = 1.0  # motion of a round at most, pixels
    blur: float = 0.8  # of both images before they are compared, pixels, as cameras are refined
    outlying: float = 2.5  # robust standard deviations from which a residual counts half
    wrong: float = 0.06  # difference of brightness that is masked, if it is also
    wrong_spreads: float = 5.0  # so many times the usual difference
    margin: int = 2  # by which the mask is eroded, pixels


@dataclass(frozen=True)
class BlurConfig:
    """Blur of a picture (`blur`); widths of kernels are standard deviations along an axis, pixels."""

    half: int = 2  # the first look is taken at pictures of this part of the size
    # Smoothing of the first look, pixels of the full size: wider than the blurs that are read, or their Taylor series
    # does not hold
    look: float = 4.0
    # Width along its long axis of a kernel that is sought: softer pictures than this read the same without it, those of
    # 0.7 to 0.9 a fifth to a third less
    least_spread: float = 0.5
    widest: float = 6.0
    # Support of the kernel: an ellipse of so many widths, and so many pixels for what the first look missed and a shift
    reach: float = 2.5
    margin: float = 2.5
    spill: int = 8  # around the model's render, where the picture may show it: half of the longest line
    samples: int = 20_000  # pixels that give the kernel, and the first look
    least_samples: int = 2_000  # with fewer, no blur is estimated
    ridge: float = 1e-5  # of the normal matrix's mean diagonal: what the render does not show is not made up
    rounds: int = 2  # of the robust fit
    outlying: float = 3.0  # robust standard deviations at which a pixel counts for half
    least_sum: float = 0.2  # of the fitted kernel, which is the picture's contrast: less is another picture
    # Share of what the sharp render misses the picture by that a kernel may leave. Blur, a poor JPEG of it, too, leaves
    # below 0.45; a picture reduced from a larger one, which is no blur of the render of its size, 0.56 and more
    explained: float = 0.6
    clipped: float = 0.985  # brighter pixels say nothing


@dataclass(frozen=True)
class ColorChangeConfig:
    """Colors of a model that were averaged or denoised (`color_change`)."""

    neighbors: int = 8  # over which an average is taken, the Gaussian itself among them
    rounds: tuple[int, ...] = (1, 4, 16)  # of averaging, after which it is looked at
    run: int = 16  # Gaussians of a run in the first look
    # Share of what the picture is off by that runs must explain in the first look: 0.4 and more of averaged colors,
    # 0.05 and more of denoised ones; of others below 0.016, but for reduced (0.036) and blurred pictures (0.13)
    looks: float = 0.04
    # Share that averages over neighbors explain from which nothing else is tried: they explain 0.90 to 0.94 where the
    # colors were averaged so, 0.65 at most where they were averaged in cells
    surely: float = 0.85
    # By which averages over neighbors of like color must explain more than those over all neighbors: of colors averaged
    # in cells 0.14 and more
    clearly: float = 0.1
    alike: tuple[int, ...] = (16, 64)  # neighbors of like color over which an average is taken
    thinned: int = 4  # and over the last number among every so many Gaussians: four times as wide
    # Neighbors within whose distance a place counts as much as a unit of color, the Gaussian itself among them
    reach: int = 33
    most_alike: int = 500_000  # Gaussians of a model that is averaged so: 1 kB each
    explained: float = 0.3  # and that the better of both must
    # Of a displacement of one color, below which a denoising is none that a curve describes: with all of a misfit gone,
    # what is left lies in other cells, and reading by the curve lost three quarters of z
    least_kept: float = 0.5
    limits: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)  # of a misfit, in the mark's size
    opaque: float = 0.9  # opacity of the reference from which a pixel shows the model
    clipped: float = 0.985  # brighter pixels say nothing
    samples: int = 40_000  # pixels on which it is fitted
    least_samples: int = 2_000  # with fewer, nothing is fitted
    fits: int = 2  # of the robust fit
    outlying: float = 3.0  # root mean square residuals at which a pixel counts for half
    ridge: float = 1e-9  # of the trace of the normal matrix
    most_gaussians: int = 4_000_000  # of a model that is smoothed: ten million take too much memory


@dataclass(frozen=True)
class BackgroundConfig:
    """What lies behind the model (`background`)."""

    clear: float = 0.02  # opacity of the reference below which a pixel shows what lies behind
    margin: int = 3  # pixels around anything more opaque that are not trusted: the camera may be off, and viewers blur
    finest: int = 4  # cell of the finest level, pixels: noise of single pixels is not what lies behind
    around: int = 16  # cell of the surroundings that show whether the background can be guessed at all, pixels
    least_share: float = 0.003  # of clear pixels, below which nothing is known of what lies behind
    trust: float = 0.05  # share of a cell that must be clear for it to count as much as its surroundings
    black: float = 1.5 / 255.0  # a mean below this is no background
    tolerated: float = 0.02  # error of what shines through a pixel up to which it carries evidence


@dataclass(frozen=True)
class DetailConfig:
    """Comparison of details, and what covers the model (`detail`)."""

    # Blurs between which detail lies, longer sides of the picture: a light and a dark part, which every other scene has
    # somewhere, are coarser; noise, compression and a picture out of focus are finer
    blurs: tuple[float, float] = (1 / 160, 3 / 160)
    side: int = 320  # longer side of the picture on which detail is compared, pixels
    least_cover: float = 0.1  # usable part of a pixel of it below which that is left out
    cells: int = 24  # along the longer side, that are covered or not: a viewer's panel spans several
    most_covered: float = 0.15  # share of what is used that something may lie over, such as a viewer's panels
    covered: float = 3.0  # root mean square residual of a covered cell, robust standard deviations


@dataclass(frozen=True)
class ToneConfig:
    """Tone curves (`tone_and_light`)."""

    samples: int = 60_000  # pixels from which they are fitted
    least_noise: float = 0.006  # softness of clipping without noise: rounding to 8 bits and what a fit leaves
    clipped: float = 0.985  # brighter pixels, and darker ones than one less this, may be clipped
    table: int = 1024  # entries of a tabulated curve
    bent: float = 0.004  # where a curve bends a twentieth of the affine colors by more, both are fitted together
    better: float = 0.8  # a curve fitted together with the mixture must miss by this share of what the plain one does
    bent_knots: int = 65  # of such a curve
    bent_rounds: int = 3  # of its fit


@dataclass(frozen=True)
class ViewerToneConfig:
    """Tone curves that a viewer applies to every Gaussian (`tone_and_light`)."""

    side: int = 256  # longer side of the renders that tell, pixels
    solid: float = 0.95  # opacity of the reference from which a pixel counts
    clipped: float = 0.985  # brighter pixels of the picture do not
    least_pixels: int = 500  # fewer do not tell
    # A curve must miss by this share of what the plain render, and a curve of it, do: of 41 pictures of two viewers the
    # right curves came to 0.68 to 0.93 but for one, curves that were not there to 1.00 and more
    better: float = 0.95
    knots: int = 9  # of that curve
    step: float = 0.01  # over which slopes are measured


@dataclass(frozen=True)
class LightConfig:
    """Uneven light (`tone_and_light`)."""

    uneven: float = 0.08  # share that a gain must take off the residual's median for light to be uneven
    still_uneven: float = 0.02  # once it is, less is worth another round
    gains: tuple[float, float] = (0.2, 5.0)  # to which a gain is clipped
    degree: int = 4  # of the polynomials of the gain
    waves: int = 20  # half waves down the rows: ten bands of flicker
    samples: int = 10_000  # pixels from which the gain is fitted
    curve_samples: int = 60_000  # pixels from which a curve of brightness is
    clipped: float = 0.985  # brighter pixels of the picture give no gain,
    black: float = 0.02  # nor do darker ones of the prediction
    tone_knots: int = 9  # of a channel's tone curve
    curve_bins: int = 32  # of brightness, each with a median
    color_rounds: int = 4  # turns of tone and light at most, with full colors
    curve_rounds: int = 3  # and with brightness alone


@dataclass(frozen=True)
class ResidualConfig:
    """Residual of an aligned picture, as evidence (`residual`)."""

    samples: int = 100_000  # pixels from which weights are estimated
    levels: int = 5  # of the Haar transform; blocks of 2^5 pixels are the coarsest details
    least_slope: float = 0.3  # share of a change that must survive clipping in every channel, or a pixel is left out
    least_pixels: int = 64  # fewer do not carry the fits
    noise_floor: float = 0.0005  # standard deviation added to every band: half of what rounding to 8 bits leaves
    clip: float = 3.0  # to which coefficients are clipped, standard deviations of their band
    # Where a band keeps this share of faint details, its errors are a renderer's, which lie along edges: coefficients
    # are divided by the variance around them. Where it keeps less, a lossy coder emptied the quiet places, whose small
    # variance would be taken for certainty
    kept: float = 0.7
    window: int = 9  # coefficients a side around one, whose mean square is its variance
    prior: float = 25.0  # coefficients for which the variance of the whole band counts in addition
    # An emptied band is divided by its variance to this power: 1 is right for noise that is independent of the mark,
    # 1/2 is kindest to lossy coders, whose noise is not
    exponent: float = 0.75
    # Range of details of the reference that are as faint as a mark's: strong ones survive where these do not
    faint: tuple[float, float] = (0.5 / 255, 2.5 / 255)
    least_details: int = 50  # fewer of them do not show how much survives
    doubts: float = 1.0  # standard errors by which less than everything must survive: noise leaves few details


@dataclass(frozen=True)
class AlignmentConfig:
    """The stages of alignment."""

    planar: PlanarConfig = PlanarConfig()
    flow: FlowConfig = FlowConfig()
    blur: BlurConfig = BlurConfig()
    color_change: ColorChangeConfig = ColorChangeConfig()
    background: BackgroundConfig = BackgroundConfig()
    detail: DetailConfig = DetailConfig()
    tone: ToneConfig = ToneConfig()
    viewer_tone: ViewerToneConfig = ViewerToneConfig()
    light: LightConfig = LightConfig()
    residual: ResidualConfig = ResidualConfig()


CONFIG = AlignmentConfig()
