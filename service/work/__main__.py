"""`python -m service.work`: the process of one task; what it says is in `process`."""

import os

from engine.kernels.allocation import keep_freed_memory
from service.work.process import serve
from service.work.tasks import TASKS, preload

if __name__ == "__main__":
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # numpy is not loaded yet; see engine.numerics.blas
    keep_freed_memory()
    serve(TASKS, preload)
