"""Tuned constants of the search for a picture's camera, a frozen config for each stage (DESIGN 4.8).

"Supporting" keypoints are inliers of a candidate. Lengths without a unit are in longer sides of the picture.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Level:
    """One resolution of the refinement."""

    side: int  # longer side of the reduced picture, pixels
    iterations: int  # renders at most
    tolerance: float  # the refinement ends at a step below this, pixels of the level


@dataclass(frozen=True)
class ClimbRound:
    """One round of the climb (`view_search`)."""

    degrees: float  # of a step around what the camera sees
    distances: tuple[float, ...]  # of other cameras, in the camera's own distance
    kept: int  # cameras that go on


@dataclass(frozen=True)
class KeypointConfig:
    """Keypoints, their matches and the cameras these support (`keypoint_cameras`)."""

    count: int = 2000  # SIFT keypoints of a picture
    detection_side: int = 1000  # longer side of the picture they are detected in, pixels
    # Lowe's ratio of distances over the bank (few matches, mostly right), and within one view (many, mostly wrong)
    ratios: tuple[float, float] = (0.8, 0.85)
    views: int = 8  # of the bank, in which the second kind is sought: the views with most matches
    same_place: float = 0.05  # landmarks nearer to each other are one place, radii of the bank
    tolerance: float = 0.005  # reprojection error of an inlier
    enough: int = 60  # inliers of a camera that is tried before any other is sought
    least_start: int = 6  # matches that must agree before the camera is roughly known
    least_inliers: int = 12  # keypoints that must agree once it is
    guided: tuple[float, ...] = (1.0, 1.0, 0.5)  # rounds of guided matching from matches, inlier tolerances
    guided_far: tuple[float, ...] = (4.0, 2.0, 1.0, 0.5)  # and from a view that only looks alike
    closer_side: int = 640  # longer side of a part of a picture, and of the render it is matched to, pixels
    # Correlation of picture and render, before they are matched: of 52 renders that found enough keypoints two had
    # less, of 425 others half
    least_resemblance: float = 0.15
    ransac_trials: int = 1000  # at each focal length
    # Where a camera sees the model: longer side of the render that tells, pixels, and the opacity that counts in it;
    # margin around the model, in its longer side; blur of what is compared, and how far around lies its outline, pixels
    glance_side: int = 160
    glance_alpha: float = 0.3
    surroundings: float = 0.15
    soft: float = 1.5
    outline: int = 4
    least_freed: int = 24  # matches needed to free the principal point, and the shape of the pixels
    # Gain in inliers by error for which it is freed: uncropped pictures 0.99 to 1.02, cropped mostly above 1.1
    freed_gain: float = 1.1


@dataclass(frozen=True)
class VoteConfig:
    """Votes of keypoints for views of the bank (`voted_views`)."""

    nearest: int = 8  # landmarks a keypoint votes for; the next nearest is the yardstick
    apart: float = 8.0  # least distance of the two votes that say how a view was turned, sized and shifted, pixels
    sizes: tuple[float, float] = (0.1, 10.0)  # of the picture in the view
    # How far a place may lie from where it should be, pixels of a view of 640: another view point moves what is nearer.
    # Less where the picture shows a part of the view, large: by the square root of how much larger
    tolerance: float = 20.0
    reach: float = 1.5  # keypoints of a view are those within so many tolerances: the map of its votes is rough
    views: int = 4  # with most votes, that are rendered and matched to the picture
    # Weight of votes: of five pictures that matches alone do not find, right views have 1.9 and more, wrong up to 1.2
    least_loudness: float = 1.3


@dataclass(frozen=True)
class EdgeConfig:
    """Search by outlines, edges and colors (`view_points`, `view_scores`, `picture_edges`, `view_search`), and the
    climb from there."""

    side: int = 96  # longer side of the picture that is searched, and of the views, pixels
    points: int = 72  # on edges of a view: half on its silhouette, half inside,
    apart: int = 2  # and so far from each other, pixels
    colors: int = 160  # points of a view whose colors are compared with the picture's,
    soft: float = 1.0  # after a blur, pixels,
    solid: float = 0.8  # where the view is so opaque that they show the model's own
    least_colors: int = 20  # of these points in the picture, for colors to count
    most_alike: float = 0.99  # correlation at which colors are clipped
    # Weight of the colors' correlation, by Fisher's transform, against the edges' standard deviations: of 32 viewers'
    # pictures 1 and 2 rank the right view alike, 0 ranks it lower, 3 and more lose what a tone curve changed
    colored: float = 1.0
    larger: float = 0.3  # power of the size by which a find counts more: small views find edges that fit in large ones
    bins: int = 8  # of edge directions, in half a turn
    rolls: int = 24  # tried, in a whole turn
    radii: tuple[float, ...] = tuple(12.0 * 1.25**k for k in range(11))  # root mean square, of the edges tried, pixels
    close_radii: tuple[float, ...] = radii[4:]  # of a part that fills a picture
    beyond: int = 24  # pixels by which the middle of the model may lie outside the picture
    step: int = 4  # pixels between the places tried
    least_inside: float = 0.35  # share of a view's points that must lie in it
    off: int = 2  # pixels an edge may be off in the search,
    off_again: int = 1  # and when the best of it are scored again
    # Of some 50,000 views, rolls and sizes, those whose edges are looked at place by place, and of these those whose
    # rolls and sizes are, too, and colors: of 27 viewers' pictures 26 are climbed home from these, from twice as many
    # no more, 20 where the best 1,500 are scored at once
    promising: int = 7500
    rescored: int = 1000
    same_roll: float = float(np.radians(18.0))  # two finds of a view are one within this roll, radians,
    same_size: float = 0.25  # this share of the size,
    same_place: float = 6.0  # and this distance, pixels of the search
    starts: int = 12  # cameras that climb
    rounds: tuple[ClimbRound, ...] = (
        ClimbRound(12.0, (0.4, 0.6, 1.6), 6),
        ClimbRound(12.0, (0.7, 1.4), 4),
        ClimbRound(6.0, (0.8, 1.25), 3),
        ClimbRound(6.0, (0.8, 1.25), 3),
        ClimbRound(3.0, (0.9, 1.1), 3),
        ClimbRound(3.0, (0.9, 1.1), 3),
    )
    same_direction: float = float(np.radians(5.0))  # climbed cameras that differ by less are one, radians
    # Score below which close-ups are searched, too: right cameras come to 8.5 and mostly to 12 to 16, wrong ones to 6
    # to 8.5, and one picture in fifty to 9.1
    fitting: float = 9.0
    least_score: float = 7.5  # of a camera that is looked at: right ones come to 8.5


@dataclass(frozen=True)
class FarConfig:
    """The model as it looks from afar (`far_views`)."""

    # Gaussians for a small picture: merged, they look more like the model (23 to 28 dB on four scenes, 16 on a city)
    # than its 30,000 most visible (21 to 26, 14), and are drawn in 1.4 ms instead of 3.3
    gaussians: int = 10_000
    sample: int = 200_000  # Gaussians on which voxels in use are counted, at least half as many
    coefficients: int = 4  # of the spherical harmonics: what light does beyond them is seen from near
    # Distance of additional views, in that of those given: through a wide lens what is near has another shape, to which
    # no search from afar leads (of five pictures that were missed two are found)
    near: float = 0.5
    # Places of a view, as far from each other as can be, at which a camera so much nearer is aimed: close-ups whose
    # middle is elsewhere (of eleven that were missed two are found; at six places one more, for twice the time)
    parts: int = 3
    nearer: float = 0.35


@dataclass(frozen=True)
class RefinementConfig:
    """Refinement on brightness (`pose_refinement`); pixels are those of the level."""

    blur: float = 0.8  # of both images before the comparison, pixels: ringing of JPEG is finer than edges
    # Blur of the first iterations, pixels; it falls to half each time, but not below the last step, so that an edge
    # overlaps with itself
    widest_blur: float = 3.0
    trusted: float = 0.1  # residual that is no outlier before then: a part that does not fit yet is not given up
    least_alpha: float = 0.5  # more transparent pixels show an unknown background
    clipped: float = 0.985  # brighter pixels of the picture say nothing about position
    damping: float = 1e-7  # of the motion, in the curvature of each of its numbers
    # At first where all are free, by half less in each iteration: before something flat they hardly show, and run away
    first_damping: float = 1e-3
    farthest: float = 2.0  # a motion by more radians, depths, or e-foldings of the zoom at once is wrong
    far_margin: int = 12  # pixels around the model that are no background while the camera is still off by many
    least_pixels: int = 150  # fewer usable ones cannot carry so many unknowns
    least_correlation: float = 0.75  # of brightness, below which a picture shows something else
    least_detail: float = 0.5  # correlation of detail below which it does
    # Standard deviations by which detail must correlate: a few strokes of a drawing, on a small piece of a model, came
    # to 5 with a correlation of 0.65, right cameras of pictures of viewers to 19 and more
    least_detail_z: float = 7.0
    # Both correlations that a small picture must show for a larger one to be looked at; right cameras came to 0.9, 0.8
    hopeful_correlation: float = 0.5
    hopeful_detail: float = 0.25
    accelerated: float = 0.5  # smaller steps are taken for linear, pixels
    memory: int = 2  # steps that the acceleration remembers
    most_extrapolation: float = 30.0  # it goes at most so many times as far as the last step


@dataclass(frozen=True)
class ShapeConfig:
    """Pixels that are not square (`uneven_pixels`)."""

    ratios: tuple[float, ...] = (0.75, 1.33)  # tried besides 1: 4:3 made of 16:9, and back; each serves others, too
    rounds: tuple[float, ...] = (3.0, 2.0, 1.0, 0.5, 0.5)  # of matching and fitting, inlier tolerances
    square: float = 0.006  # a shape nearer to square is taken as square


@dataclass(frozen=True)
class FrameConfig:
    """A page or a player around the model's viewer (`viewer_frame`)."""

    side: int = 320  # longer side of the reduced picture, pixels
    solid: float = 0.7  # opacity of the render from which the picture must show it
    blur: float = 1.0  # of picture and render, pixels: the camera is not right yet
    window: float = 3.0  # blur of the surroundings that are compared, pixels
    texture: float = 0.005  # standard deviation of brightness from which surroundings are compared
    alike: float = 0.5  # correlation from which they agree
    least_outside: float = 0.03  # share of the model's pixels beyond the frame, for there to be one
    least_inside: float = 0.2  # and within it
    rounds: int = 2  # of cutting off sides: what one leaves is seen better without the others


@dataclass(frozen=True)
class GroundConfig:
    """Something on a plain ground (`camera_search`)."""

    side: int = 320  # longer side of the reduced picture, pixels
    plain: float = 0.03  # difference of color up to which a pixel of the border is ground,
    least_border: float = 0.95  # as this share of them must be
    other: float = 0.05  # and from which a pixel is not: JPEG's ringing is fainter
    joined: int = 3  # pixels by which what is near is one part
    least_part: float = 0.05  # of the largest part's area: smaller ones are buttons, or floaters
    margin: float = 0.1  # around it, of its longer side: ground must be seen
    most: float = 0.85  # of the picture's longer side, above which the picture is searched as it is


@dataclass(frozen=True)
class CameraSearchConfig:
    """The search itself (`camera_search`), and its stages."""

    least_side: int = 16  # of a picture, pixels
    least_spread: float = 1.5 / 255  # of its values, in each channel: rounding of one color spreads them by one step
    focals: tuple[float, ...] = tuple(np.geomspace(0.5, 2.0, 5))
    """Focal lengths tried, in widths; 41 % apart: with nine, as many of 80 pictures are found."""
    other_focals: tuple[float, ...] = (1.4, 0.75, 1.9)  # tried where refinement from that of keypoints fails, in that
    supported: int = 30  # inliers of a camera that needs no second opinion, if its render looks like the picture
    settled_correlation: float = 0.9  # of brightness with the render, with which a supported camera ends the search
    # Correlation without covered parts from which pixels are square and no page is around: square pixels came to 0.975
    # and more, others mostly to 0.7 to 0.95
    explained_uncovered: float = 0.96
    # Correlation of all, needed besides: overlays leave right cameras 0.83 and more, but for one picture in fifty; the
    # page around the photograph of a screen leaves 0.7
    explained: float = 0.8
    # Uncovered correlation of a small picture from which full size is tried at once: of eight pictures below, none came
    # to `explained_uncovered` there, of four above three
    nearly_explained: float = 0.93
    small_levels: tuple[Level, Level] = (Level(256, 8, 0.05), Level(640, 8, 0.05))
    full_level: Level = Level(1600, 12, 0.005)  # or the picture's own size, if that is smaller
    full_edge: float = 0.05  # step of brightness from which an edge counts in full for a candidate's score
    error_per_step: float = 4.0  # a refined camera is off by at most so many last steps: the rest shows slowly
    # With the principal point and the shape of the pixels free; and the step of all from which that is tried, pixels:
    # pictures that the principal point explained 3 % better moved by 0.07 and more, uncropped ones mostly by up to 0.04
    free_level: Level = Level(1600, 20, 0.005)
    free_step: float = 0.05
    clearly_better: float = 1.03  # gain in likelihood to believe another way of drawing; wrong ones came to 1.02
    glance_better: float = 1.02  # the same after one iteration, which is within about 1 % of the end
    keypoints: KeypointConfig = KeypointConfig()
    votes: VoteConfig = VoteConfig()
    edges: EdgeConfig = EdgeConfig()
    far: FarConfig = FarConfig()
    refinement: RefinementConfig = RefinementConfig()
    shape: ShapeConfig = ShapeConfig()
    frame: FrameConfig = FrameConfig()
    ground: GroundConfig = GroundConfig()


CONFIG = CameraSearchConfig()
