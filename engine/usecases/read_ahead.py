"""Work that is begun while the modules are still being imported."""

import threading
from collections.abc import Callable
from typing import Generic, ParamSpec, TypeVar

__all__ = ["Ahead"]

P = ParamSpec("P")
T = TypeVar("T")


class Ahead(Generic[T]):
    """What a function gives, worked out on a thread of its own from now on.

    For what leaves nothing behind, such as reading a file: where the command ends before, it is dropped.
    """

    def __init__(self, function: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> None:
        self._answer: list[T] = []
        self._error: BaseException | None = None

        def work() -> None:
            try:
                self._answer.append(function(*arguments, **named))
            except BaseException as error:  # the caller's, wherever it was raised
                self._error = error

        self._thread = threading.Thread(target=work, daemon=True)
        self._thread.start()

    def result(self) -> T:
        """What it gives, once it is there; errors are the function's."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._answer[0]
