"""`python -m service.work`: the process of one task; what it says is in `process`."""

from service.work.process import serve
from service.work.tasks import TASKS, preload

if __name__ == "__main__":
    serve(TASKS, preload)
