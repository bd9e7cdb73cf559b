"""How many Gaussians a compressed file may claim to hold: what a small file can make the reader allocate."""

from engine.errors import FormatError

FREE_COUNT = 1 << 20
"""Any file may hold this many: some 300 MB while it is read."""

GAUSSIANS_PER_BYTE = 4
"""Beyond that, at most four Gaussians a byte. Real scenes need 6 to 40 bytes for one; a quarter of a byte is
reached only by rows that all say the same (a 591 KB SPZ can hold 9.5 million of them, 608 MB)."""


def check_count(count: int, size: int, *, file: str) -> None:
    """Refuse a number of Gaussians out of all proportion to the file that claims it.

    Parameters
    ----------
    count : int
        Gaussians claimed.
    size : int
        Length of the whole file (or of all files of a folder), bytes.
    file : str
        Name of the file, for the message.

    Raises
    ------
    FormatError
        The count is zero, negative, or a decompression bomb.
    """
    if count < 1:
        raise FormatError(f"holds {count} Gaussians", file=file)
    if count > max(FREE_COUNT, GAUSSIANS_PER_BYTE * size):
        raise FormatError(f"claims {count} Gaussians in {size} bytes", file=file)
