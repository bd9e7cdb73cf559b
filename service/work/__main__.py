"""`python -m service.work`: the process of one task; what it says is in `process`."""

import os

from service.work.process import serve
from service.work.tasks import TASKS, preload

if __name__ == "__main__":
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # numpy is not loaded yet; see engine.numerics.blas
    serve(TASKS, preload)
