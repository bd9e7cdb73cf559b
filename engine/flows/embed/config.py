"""Tuned constants of an embedding, a frozen config for each stage (DESIGN 4.2 to 4.6); what users set is in `profiles`.

Fidelities are PSNR in dB or SSIM of the marked against the unmarked render, in the worst key view.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class AutoConfig:
    """Choice of a profile (`auto_profile`)."""

    margin: float = 1.15  # promised over needed z: with other chips z is one more or less, in other views a little, too
    slack_db: float = 2.0  # by which the mark may fall short of its PSNR in a view that no key view was near
    view_size: int = 256  # side of the key views, pixels: 256 shape a mark just as 800 do (docs/RESULTS.md, profiles)
    views: tuple[int, ...] = (6, 10, 16)  # numbers of key views, in the order in which they are tried
    # What may be taken off the PSNR where evidence is short, dB; the last gives the fidelity of `strong`
    lower_db: tuple[float, ...] = (1.0, 2.0)
    ssim_per_db: float = 0.0005  # and off SSIM with it, as in `strong`
    kept_share: float = 0.9  # share of what the whole model promises, if too little, that a smaller file must keep
    # How long `balanced` looks at a scene and settles its mark, in views of a rehearsal drawn, marked and read: 5.6 to
    # 6.9 on four scenes
    balanced_views: float = 6.3


@dataclass(frozen=True)
class PlanConstants:
    """Plan, delivery and refinement (`planning_basis`, `delivery`, `refinement`)."""

    compact: int = 4  # by how much fewer public cells the compact output has, of whose code vectors its file consists
    # Width of the centers across a line through them, in its length: a rotation about the line itself shows nowhere
    least_width: float = 1e-4
    band_share: float = 0.05  # of the pruning budget's squared error, that dropping SH bands may use
    left_a_code: float = (
        4.2  # Gaussians left by pruning in turns with recovery: with fewer, pictures show less of the mark
    )
    most_stages: int = 5  # of residual code vectors
    mark_room_db: float = 0.8  # by which the compact output stays above `compact_db`: the mark takes it
    fit_gain_db: float = 4.0  # most that fitted code vectors are hoped to gain: further off, a stage is learnt at once
    apart: float = 0.5  # shift of each half along the longest axis, standard deviations of the whole along it
    bit_temperature: float = 4.0  # z per bit at which the message loss saturates: a bit error of 3e-5


@dataclass(frozen=True)
class StrengthConfig:
    """Strengths of tint, grain and copy layer (`layer_strengths`, `copy_mark`)."""

    draws: int = 4  # plans tried: weaker ones where the owner's own chips show more than the public ones did
    copy_draws: int = 6  # of a copy's layer: the first that shows no more than wanted is taken, else the least visible
    copy_margin_db: float = 0.1  # by which the owner's layer stays above the wanted PSNR where copies' draws follow, dB
    margin_db: float = 0.05  # above the target, for chips that meet less luckily than the public ones, dB
    rounds: int = 10  # renders of all views, at most
    # Rounds after which the interval is halved. SSIM falls faster than with the factor's square where splats reach over
    # a black background; steps that trust the square then jump to and fro across the target
    patience: int = 2
    # How far above the wanted PSNR the grain alone stays, dB: a quarter of the squared error. It has chips enough; what
    # it takes away is evidence of pictures
    grain_room_db: float = 6.0
    grain_ssim_share: float = 0.25  # of what SSIM may lose; SSIM sees moved edges sooner than squared error does
    sample: int = 10_000  # Gaussians that give the median size
    grain_rounds: int = 4  # measurements of the grain, at most
    # Errors grow more slowly than the grain where a hair's breadth turns the order of Gaussians round (playbot: to the
    # power of a half); the exponent is taken from the last two measurements, and not below this
    least_growth: float = 0.3
    close: float = 0.05  # excess over its part of the budget, in log of amplitude, below which a grain stays
    waste: float = 0.3  # and room left in it
    # Steps of a lattice, in the grain's own, beyond which an attribute carries none: rounding would cost more of the
    # fidelity than the grain, and show in every reading as noise
    coarse: float = 2.0


@dataclass(frozen=True)
class BankConfig:
    """Views of the landmark bank (`landmark_bank`)."""

    tried: int = 3  # views that are made first: low, midway and high
    # Landmarks each of them must show for a third of the views to do: two assets show 649 and more, of whose pictures
    # out of a viewer as many are found; three show 223 to 423, and the two of them that were tried lose some
    rich: int = 600
    of_rich: int = 900  # landmarks of one view there, at most
    least: int = 24  # views wanted below which none are saved


@dataclass(frozen=True)
class RehearsalConfig:
    """The bad pictures that a mark is tried on (`auto_profile`)."""

    side: int = 800  # of the picture, pixels
    quality: int = 10  # of the JPEG it goes through
    noise: float = 0.1  # standard deviation in the other bad picture, range 1
    # Views that no key view was. One view's z varies by 8 %, and each costs as much as three key views
    held_out: int = 3


@dataclass(frozen=True)
class EmbedConstants:
    """The stages of an embedding."""

    auto: AutoConfig = AutoConfig()
    plan: PlanConstants = PlanConstants()
    strength: StrengthConfig = StrengthConfig()
    bank: BankConfig = BankConfig()
    rehearsal: RehearsalConfig = RehearsalConfig()


CONFIG = EmbedConstants()
