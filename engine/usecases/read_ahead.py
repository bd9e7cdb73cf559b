"""Work that is begun while the modules are still being imported."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import ParamSpec, TypeVar

__all__ = ["ahead"]

P = ParamSpec("P")
T = TypeVar("T")


def ahead(function: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> Future[T]:
    """What a function gives, worked out on a thread of its own from now on.

    For what leaves nothing behind, such as reading a file: where the command ends before, it is dropped.
    """
    answer: Future[T] = Future()

    def work() -> None:
        try:
            answer.set_result(function(*arguments, **named))
        except BaseException as error:  # the caller's, wherever it was raised
            answer.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return answer
