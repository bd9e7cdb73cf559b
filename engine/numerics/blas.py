"""One thread for BLAS while an answer is made: a sum split over threads differs in its last digits.

A claim must be the same on any number of cores, and an embedding is faster without a second thread pool. The
commands say so in OPENBLAS_NUM_THREADS before anything is loaded; this holds it for a program that loaded numpy first.
"""

import threading
from contextlib import ContextDecorator
from types import TracebackType

from threadpoolctl import OpenBLASController, threadpool_limits


class _OneBlasThread(ContextDecorator):
    """Overlapping uses are one: the first to come in lowers the number of threads, the last to leave restores it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._limits: threadpool_limits | None = None

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                self._limits = threadpool_limits(limits=1, user_api="blas")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0 and self._limits is not None:
                # Only the thread that lowered the number may raise it again, unless that is taken from it.
                OpenBLASController.clear_controlling_thread(force=True)
                self._limits.restore_original_limits()
                OpenBLASController.clear_controlling_thread()
                self._limits = None


one_blas_thread = _OneBlasThread()
"""`with one_blas_thread:`, or `@one_blas_thread` on a function."""
