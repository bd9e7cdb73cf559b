"""How the C library keeps memory that a program gave back.

By default glibc asks the kernel for new pages for every large array, which fills them with zeros, and returns them when
the array is gone. A command makes thousands of arrays one after another: to keep what is freed takes a fifth off
verifying a model, for a tenth more memory at the peak of an embedding.
"""

import sys

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3  # of mallopt(3)
_KEPT = 1 << 30
"""Free bytes at the end of the heap that are kept."""
_APART = 1 << 27
"""Arrays of so many bytes get pages of their own, which are returned at once: few, and holes of theirs would last."""
_STEP = 1 << 26
"""Bytes by which the heap grows."""


def keep_freed_memory() -> None:
    """Set it up for this process; where the library is another one, nothing is done."""
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # musl
        return
    for option, value in ((_TRIM_THRESHOLD, _KEPT), (_TOP_PAD, _STEP), (_MMAP_THRESHOLD, _APART)):
        mallopt(option, value)
