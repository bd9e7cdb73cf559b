"""`python -m service.work`: the process of one task; what it says is in `process`."""

import os
from collections.abc import Mapping

from service.work.process import Task, serve


def _tasks() -> Mapping[str, Task]:
    from service.work.tasks import TASKS

    return TASKS


def _warm_up() -> None:
    from service.work.tasks import preload

    preload()


if __name__ == "__main__":
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is loaded; see engine.numerics.blas
    serve(_tasks, _warm_up)
