"""Memory that was freed is handed out again, not requested from the kernel anew."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from engine.kernels.allocation import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
np.ones(8 << 20)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    np.ones(8 << 20)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
def test_arrays_one_after_another_use_the_same_pages() -> None:
    faults = {}
    for how in ("kept", "as it is"):
        run = [sys.executable, "-c", FAULTS, how]
        environment = {**os.environ, "NUMPY_MADVISE_HUGEPAGE": "0"}
        done = subprocess.run(run, env=environment, capture_output=True, text=True, check=True)
        faults[how] = int(done.stdout)
    assert faults["as it is"] > 10 * (64 << 20) / 65536
    assert faults["kept"] < 0.05 * faults["as it is"]
