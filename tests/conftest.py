"""Several pytest processes share the machine: each keeps to one thread, so do the children that it starts."""

import os

# A pool of two on a machine with one core, too: tests compare what one and two threads answer (`tests.threads`).
os.environ.setdefault("NUMBA_NUM_THREADS", "2")

if "PYTEST_XDIST_WORKER" in os.environ:
    # Before BLAS and OpenMP are loaded, which look only once.
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    import numba

    numba.set_num_threads(1)
