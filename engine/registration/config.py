"""Tuned constants of registration and of sketches, a frozen config for each stage (DESIGN 4.7).

Numbers of Gaussians, of pairs and of rounds have no unit. An extent is the size of the reference.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Agreement:
    """How exactly two candidates must agree."""

    size: float  # difference of the two changes of log size
    edge: float  # difference between the log ratio of the distances and the change of log size
    angle: float  # between the two rotations and along the line, radians; infinity leaves rotations out

    @property
    def cosines(self) -> tuple[float, float]:
        """Of half the angle, and of all of it; -1 where rotations are left out."""
        return (math.cos(self.angle / 2), math.cos(self.angle)) if math.isfinite(self.angle) else (-1.0, -1.0)


@dataclass(frozen=True)
class LooksConfig:
    """Features of single Gaussians and the tree of them (`match_candidates`, `matching`)."""

    logit_clip: float = 5.0  # opacity logit beyond which 8-bit opacities (steps of 1/255) no longer differ
    flatness_clip: float = 7.0  # log ratio of sizes beyond which a disc is one: a third axis of a thousandth is noise
    tree_points: int = 150_000  # reference Gaussians in the feature tree at most, the rarest ones


@dataclass(frozen=True)
class SimilarityConfig:
    """Search for the similarity (`similarity_search`)."""

    exact: Agreement = Agreement(0.08, 0.08, 0.12)  # lossy formats: log scales in steps of 1/16, 8-bit quaternions
    loose: Agreement = Agreement(0.35, 0.30, 0.40)  # noise of a tenth of each attribute's standard deviation
    candidates: int = 3000  # pairs per stage; the time of a stage grows with their square
    seeds: int = 64  # candidates around which triples are drawn
    draws: int = 64  # triples per such candidate
    min_scale: float = 1e-3  # scales outside these two are not credible
    max_scale: float = 1e3
    least_evidence: float = 12.0  # of a hypothesis that is tested against the whole models, nats
    sample: int = 4000  # suspect Gaussians on which a hypothesis is tested and refined
    glance: int = 400  # suspect Gaussians on which the turns of the axes are compared
    least_matches: int = 5  # distinct reference Gaussians matched in the sample, or nothing is found


@dataclass(frozen=True)
class ConfirmationConfig:
    """Test and refinement of a similarity (`agreement`)."""

    rounds: int = 8  # of match, fit and re-measure; exact suspects need one, noisy ones four or five
    glance: int = 250  # suspect Gaussians on which a hypothesis is dismissed without further work
    # Share of the reference's Gaussians smaller than the suspect's smallest from which sizes are believed clipped
    clipped: float = 0.001
    decoys: int = 3  # wrong similarities of equal scale and place; the right one must explain more than each


@dataclass(frozen=True)
class OrderConfig:
    """Pairs of reference and suspect Gaussians of one row, where the order was kept (`agreement`)."""

    sample: int = 4000  # pairs that show whether the order was kept
    rounds: int = 4  # of measuring errors on the pairs that agree; where half are wrong, the first is far too large
    reach: int = 8  # places up or down an order in which a row's partner may stand
    far_more_alike: float = 0.05  # of the squared difference in looks; by chance one in some hundred neighbors is
    moved_up: float = 0.3  # share of such rows beyond which the order was not kept
    # Share of pairs in order without trust that are not searched elsewhere: building the reference's grid costs most
    # of the time
    strays: float = 0.001


@dataclass(frozen=True)
class ClassesConfig:
    """Errors that grow with the size of the Gaussians (`match_classes`)."""

    count: int = 6  # classes, of equally many suspect Gaussians each
    sample: int = 2_000  # suspect Gaussians of a class from which its errors are estimated
    rounds: int = 8  # of estimating and matching
    least_pairs: int = 32  # matches of a class below which its errors are not estimated
    growth: float = 1.5  # ratio of the errors of two classes from which classes are worth their time
    # Error of a class, in its own sizes, beyond which it is not believed: moved by four of them, nothing looks right
    own_size: float = 8.0


@dataclass(frozen=True)
class DeformationConfig:
    """Search for a deformation, and the field that describes it (`deformed`, `patches`)."""

    glance: int = 4_000  # suspect Gaussians that decide whether a deformation is sought
    neighbors: int = 16  # of those, that show what is explained nearby
    region: float = 0.05  # share of the suspect in unexplained regions from which a search is worth its time
    smooth: float = 0.5  # share of the similarity's squared errors that neighbors must share: noise has a sixteenth
    cycles: int = 3  # of patches and growth: parts that do not hang together are found one after the other
    patches: int = 8  # tried in a cycle
    # Ratio of pairs of mirrored patches to those of others that makes the suspect a mirror image; flat ones may be both
    clearly: float = 1.1
    gain: float = 0.02  # share of the suspect that a field must explain beyond what the similarity does
    sample: int = 24_000  # suspect Gaussians from which the field is grown
    nodes: int = 1_000  # of the field: about 24 of the sample each
    node_pairs: int = 32  # matches from which a node's map is fitted
    rounds: int = 40  # of growth: a front goes about one node further a round; 1,000 nodes on a surface are 32 across
    measured: int = 4_000  # matches from which the remaining errors are measured
    bend: float = 0.1  # error of a map one node further on, in distances between nodes
    explained: float = 0.2  # share of a node's surroundings that must be matched for it to hand its map on
    ridge: float = 0.02  # weight of the prior of a map, in mean squares of the source: decides across flat pieces only
    reweightings: int = 4  # of the robust fit of a map


@dataclass(frozen=True)
class PatchConfig:
    """Patches of a deformed suspect (`patches`)."""

    size: int = 400  # Gaussians: few enough that the deformation is affine across it, enough to be no accident
    look_alikes: int = 3  # reference Gaussians considered for each suspect Gaussian
    crowds: int = 6  # of pairs, examined in a patch
    draws: int = 400  # affine maps per crowd
    tolerance: float = 0.05  # error of a pair that a map explains, radii of its crowd: a 90 degree bend takes half
    most_skewed: float = 8.0  # largest ratio of the stretches of a believable map along its axes
    least_pairs: int = 16  # that must agree beyond the four that made the map
    least_share: float = 0.15  # of a patch, that its map must explain in the end
    counted: int = 600  # reference Gaussians that give the radius of a crowd within a few per cent


@dataclass(frozen=True)
class MergingConfig:
    """Suspects of merged Gaussians: parts, their wholes and the placement (`mixtures`, `merged`)."""

    neighbors: int = 8  # nearest suspect Gaussians among which a reference Gaussian's whole is sought
    # Largest squared distance of a part from its whole, its own spread included, in the whole's covariance. Over all
    # parts this is 3 in the mean, weighted by mass, so that a part of a tenth of the mass cannot lie farther
    limit: float = 30.0
    # Spread of DC color among the parts of one Gaussian, SH units. Tools merge what looks alike; a smaller value would
    # draw parts to the suspect's own colors, and the displacements out of the evidence
    color_std: float = 0.4
    # Disagreements of the moments that halve the trust: squared distance of the means, in the covariance, and log ratio
    # of the mean variances. Right mixtures at a tenth of the Gaussians have 0.02 to 0.1 and 0.1, wrong ones 5 and 1
    mean_off: float = 0.1
    size_off: float = 0.3
    thin: float = 1e-6  # share of its trace added to a covariance, so that discs have an inverse
    glance: int = 1_000  # reference Gaussians on which placements are compared
    sample: int = 5_000  # reference Gaussians on which one is refined
    rounds: int = 15  # of assigning parts to wholes and fitting again; far-off starts need the most
    settled: float = 1e-6  # change of the placement that ends them, extents
    close: float = 1e-3  # change from which parts are mixed anew, extents
    spots: int = 24  # places at which a placement is looked at
    around: int = 16  # suspect Gaussians at each
    promising: float = 0.05  # their mean trust below which it is dismissed early: half of `least`
    # Mean trust that mixtures must exceed: right ones have 0.25 to 0.8, wrong placements 0.01, and centers that fit
    # under the looks of others 0.03
    least: float = 0.1
    trusted: float = 0.1  # trust from which a mixture counts as found


@dataclass(frozen=True)
class PiecesConfig:
    """Several pieces of the asset in one suspect (`pieces`)."""

    most: int = 8  # pieces sought by default
    # Share of the suspect's Gaussians below which nothing is sought in what is left over: formats leave as many of an
    # intact asset (plant: 151 to 185 of 113,648), and to look costs more than all else
    left_over: float = 0.002
    # Median distance at which two placements put a piece below which they are one, extents: noise leaves over what
    # belongs to the piece before
    same_place: float = 0.01
    as_well: float = 0.9  # share of what a field of local maps explains that rigid pieces must explain to replace it


@dataclass(frozen=True)
class CoarseConfig:
    """Places of a model, described from a little way off (`coarse`); a window's deviation is a neighborhood."""

    neighborhood: float = 0.2  # standard deviation of the window about a place, extents; the finer scale has half
    voxel: float = 0.2  # side, neighborhoods
    apart: float = 1 / 3  # distance between places, neighborhoods
    reach: float = 2.5  # where a window ends, neighborhoods
    least_voxels: int = 8  # within reach of a place, below which it is not described
    ladder: float = 1.25  # step between the sizes of neighborhood that a suspect is described at
    most_gaussians: int = 300_000  # that are looked at in a larger model: averages over hundreds do not need all
    # How exactly two pairs of places agree about the scale, as in `Agreement`: a step of the ladder either way
    agreement: Agreement = Agreement(0.25, 0.25, math.inf)
    seeds: int = 32  # pairs about which triples are drawn
    draws: int = 32  # triples about each
    shuffles: int = 3  # of the pairs, which give the evidence of chance
    least_spread: float = 0.01  # of a feature, by which it is measured


@dataclass(frozen=True)
class SketchConfig:
    """Sketches of models and their comparison (`sketch`)."""

    # Agreeing partners from which a suspect may derive from a model. On seven real scenes under the attacks of
    # `engine.lab.sim` foreign pairs reach at most 4; derivatives, down to a tenth of the model or noise of a fifth of
    # every attribute's spread, at least 15
    alike: int = 6
    points: int = 2048  # Gaussians in a sketch: 60 kB
    suspect_points: int = 8192  # Gaussians of a suspect that are looked up: pasted parts share the regions of a scene
    pool: int = 100_000  # at most twice as many Gaussians are weighed for a sketch: a matter of time alone
    regions: int = 8  # along each axis: a small piece of the model holds its share of the sketch
    places: int = 256  # described in a sketch: 14 kB
    suspect_places: int = 2000  # described in a suspect at each size of neighborhood
    ladder_steps: int = 5  # sizes of neighborhood: those of a piece of 0.4 of the whole's extent reach the whole's
    # Evidence of the places that counts as one agreeing partner. On seven real scenes foreign pairs, pieces of them and
    # noisy ones reach at most 50, models merged to a twentieth at least 280
    nats: float = 12.0
    most_pairs: int = 512  # partners compared for agreement, the least ambiguous; the time grows with their square
    crowd: int = 256  # Gaussians of one look that a suspect is searched by
    # Expected errors of the looks (two size ratios, opacity logit, DC color): rounding, noise, a mark, a slight tint
    look_errors: tuple[float, ...] = (0.08, 0.08, 0.2, 0.12, 0.12, 0.12)
    box: float = 3.0  # search radius per look, in those errors
    limit2: float = 16.0  # squared search radius in all, in those errors


@dataclass(frozen=True)
class VisibilityConfig:
    """Gaussians that viewers draw (`visibility`)."""

    # Part of `ALPHA_SKIP` that counts as drawn: one step of 8-bit opacity is `ALPHA_SKIP` itself, and half floats store
    # it up to 0.2 % off
    rounded: float = 0.99
    hardly: float = 2.0  # of `ALPHA_SKIP`: opacity below which rounding or slight noise may hide a Gaussian
    smallest: float = 1e-10  # largest scale, scene units, below which a Gaussian has no size: zero is read as 1e-13


@dataclass(frozen=True)
class PointsConfig:
    """Clouds of colored points (`colored_points`)."""

    steps: int = 4  # classes of each channel: 64 cells, of which few hold much of a scene
    least: int = 24  # points of a class, and pairs from which a similarity is refined
    sample: int = 6000  # points that are paired with the reference's
    first: float = 0.3  # of the model's reach, within which the first pairs lie; each round's are narrower
    narrower: float = 0.7
    rounds: int = 16  # the last pairs lie within 0.0014 of the reach
    color_weight: float = 8.0  # of the width: by how much a whole step from black to white counts as apart


@dataclass(frozen=True)
class RegistrationConstants:
    """The registration itself (`registration_search`), and its stages."""

    fit_sample: int = 50_000  # matched pairs from which the similarity is fitted in the end
    explained: float = 0.97  # mean trust in the matches below which `ClassesConfig` is tried
    mostly: float = 0.5  # share of the suspect that one hand must explain, or the rest is tried with the other, too
    least_rest: int = 64  # Gaussians below which nothing is sought in what is left over: as few as a mark needs
    # Share of the suspect's Gaussians without a match from which merged Gaussians are sought among them: a voxel tree
    # makes many into few
    left_over: float = 0.02
    looks: LooksConfig = LooksConfig()
    similarity: SimilarityConfig = SimilarityConfig()
    confirmation: ConfirmationConfig = ConfirmationConfig()
    order: OrderConfig = OrderConfig()
    classes: ClassesConfig = ClassesConfig()
    deformation: DeformationConfig = DeformationConfig()
    patches: PatchConfig = PatchConfig()
    merging: MergingConfig = MergingConfig()
    pieces: PiecesConfig = PiecesConfig()
    coarse: CoarseConfig = CoarseConfig()
    sketch: SketchConfig = SketchConfig()
    visibility: VisibilityConfig = VisibilityConfig()
    points: PointsConfig = PointsConfig()


CONFIG = RegistrationConstants()
