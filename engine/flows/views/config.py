"""Tuned constants of generated views, a frozen config for each stage (DESIGN 4.1)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RigConfig:
    """Cameras around a model (`camera_rig`)."""

    field_of_view: float = 0.85  # horizontal, radians (about 49 degrees: a phone's main lens)
    landmark_size: tuple[int, int] = (640, 480)  # of a view of the landmark bank, pixels
    lowest: float = 8.0  # elevation of a view, degrees
    lowest_of_ground: float = 25.0  # and of ground, which shows next to nothing from below
    highest: float = 55.0
    flat: float = 0.2  # share of its width that ground is lower than
    # Views of ground, in those as close to each other around what stands upright: of 30 pictures of a city 60 keypoints
    # or more agree with the right camera with 14 views as with 28
    of_ground: float = 0.5
    room_emptiness: float = 0.03  # a room has less than this share of its visible area within 45 % of its radius


@dataclass(frozen=True)
class DisplayConfig:
    """The view that shows a model to people (`display_view`)."""

    whole: float = 0.998  # share of a model's visible centers that a view of it shows,
    margin: float = 0.92  # within so much of the picture's half sides
    widest: float = 0.6  # least focal length in that of the rig: what lies farther out is far from the model
    behind: float = 0.1  # a camera with a larger share of a model behind it stands in a room
    faint: float = -2.0  # opacity logit below which a Gaussian's place counts for nothing
    same_shape: float = 0.02  # difference of the ratios of sides up to which a picture may be another one, made smaller
    sure_correlation: float = 0.95  # above it, a picture lies the right way round
    trial_views: int = 6  # among which the view is chosen
    trial_size: int = 72  # longer side of their renders, pixels
    trial_gaussians: int = 40_000  # that are drawn in them


@dataclass(frozen=True)
class CostConfig:
    """Models that take too long to draw (`render_cost`)."""

    # Pairs of tile and Gaussian in a view of `side`: 23 times what the fullest of eight real scenes has (500,000
    # Gaussians, 1.27 million). So many take about five seconds to list and blend on two cores
    most_pairs: int = 30_000_000
    # Longer side of the views that are counted, pixels, whatever that of the cameras: landmarks and pictures for people
    # have sizes of their own
    side: int = 800
    views: int = 4  # of a suspect, whose own cameras are unknown


@dataclass(frozen=True)
class ViewsConfig:
    """Views of a model."""

    rig: RigConfig = RigConfig()
    display: DisplayConfig = DisplayConfig()
    cost: CostConfig = CostConfig()
    frequency_views: int = 8  # around the model, from which W^freq is measured (`view_set`)
    frequency_size: int = 400  # their side, pixels


CONFIG = ViewsConfig()
