"""Tuned constants of the search for JPEG's traces and of the score that uses them, a frozen config (DESIGN 4.8)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class JpegConfig:
    """Grid, table and coefficients of a coder; coefficients are in gray levels."""

    least_step: float = 3.0  # smaller steps hide in the rounding of the decoded picture to 8 bits
    decoded_rows: int = 64  # rows of a picture that show whether it was decoded from 8 bits
    sampled: int = 600  # blocks by which places are ranked: a few hundred separate them at quality 92
    empty: float = 0.75  # a coefficient below which a coder may have stored none: 8 bits round it by a third of that
    places: int = 3  # the likeliest, whose coefficients are compared with every table
    blocks: int = 1500  # whose coefficients are compared with a table
    coarsest: int = 33  # the first coefficient that is not, row by row in a block
    qualities: tuple[int, int] = (2, 92)  # of libjpeg, first and last: those that leave a trace
    better: float = 0.7  # share of what gain and offset leave that tone and uneven light must leave at most
    nearby: int = 3  # blocks a side over which a mark's strength is taken as constant
    rounding: float = 0.5  # standard deviation of a coefficient's error from 8-bit rounding before and after coding
    # Share of equal multiples from which the score reads a picture: our own renders have 0.68 and more at quality 50,
    # viewers' pictures to 0.64. Of these the general weighting reads 1.3 times the z at quality 50, 1.5 at 80
    own_agreement: float = 0.6
    # Chroma of a coder: mean distance from the nearest multiple of its table, in steps, below which it is that table's
    # (0.25 is chance), of at least so many multiples that are not zero
    chroma_off: float = 0.15
    chroma_loud: int = 40
    chroma_nearby: int = 5  # blocks a side over which another renderer's error is measured,
    chroma_quiet: float = 0.1  # and the least share of the picture's that it is taken for


CONFIG = JpegConfig()
