"""Tuned constants of a verification, frozen; what users set is in `decision.VerifyConfig` (DESIGN 4.9)."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class AppearanceConfig:
    """A suspect that looks like the asset, but shares no Gaussian with it (`appearance_search`)."""

    view_size: tuple[int, int] = (640, 480)  # of a render, pixels: as the landmarks were made
    views: int = 6  # with one side up; then the model is turned over and tried again
    enough: int = 6  # sightings that agree with each other after which no further view is rendered,
    fair: int = 3  # or no further side turned up
    least: int = 2  # sightings that must agree for the place to be known
    most_zoomed: float = 0.1  # log ratio of found and true focal length beyond which a sighting is wrong
    same_turn: float = math.radians(3.0)  # between sightings of one place, radians
    same_place: float = 0.05  # between them, in the distance to what they show


@dataclass(frozen=True)
class EvidenceConfig:
    """What a suspect says (`suspect_evidence`)."""

    # Agreement of a coder's multiples below which a picture was drawn by another renderer and is not carried: softness
    # adds 0.14 at most, and the score reads from 0.6. A viewer's picture of quality 80 came to 0.41; of five, carried
    # with 6 s more each, z was 0.95 to 1.01 of what it is without; of three whose chroma is then scored, 0.86 to 1.09
    coded_alike: float = 0.46
    carried: int = 2  # times that a camera is carried to a picture: the first shows what alignment elsewhere missed
    # Blurs that turning or shrinking a picture may have left in it, pixels: bilinear turns come to 0.45
    soft: tuple[float, ...] = (0.35, 0.45, 0.55)
    derived_least: float = 0.02  # share of the reference to be found before a suspect is called derived from it
    sample: int = 50_000  # matched Gaussians on which the exactness is measured
    # Longer side of a suspect's render at the pose key, pixels, however large the key views were: all together see
    # enough, and soon
    render_size: int = 512
    like_mass: float = 0.5  # share of the heaviest mass from which a duplicate counts in full: halves differ so much
    refinements: int = 12  # renders at most to refine a view's camera, as `find_camera` does
    refined: float = 0.005  # step that ends it, pixels
    glances: int = 3  # views from which a model without a Gaussian of the reference must look like it, to be in place
    glance_points: int = 2000  # of the reference, by which it is measured how far off it lies,
    exact: float = 0.3  # pixels below which it lies there to the last digit: smoothed colors alone come to 0.24
    edge_views: int = 96  # in which a picture without keypoints is sought,
    # from so low to so high around an object, degrees: the climb from the nearest one gets no farther than 25
    edge_elevations: tuple[float, float] = (-10.0, 75.0)
    close_views: int = 64  # of which close-ups are made, from where people look at it
    edge_size: tuple[int, int] = (640, 480)  # of these, pixels


@dataclass(frozen=True)
class VerifyConstants:
    """The stages of a verification."""

    appearance: AppearanceConfig = AppearanceConfig()
    evidence: EvidenceConfig = EvidenceConfig()


CONFIG = VerifyConstants()
