"""What went wrong in a task, as reported to the parent: a kind of `service.problems`, a text and its numbers."""

import errno
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

from engine.errors import CameraError, CapacityError, FormatError, InputError, KeyFileError
from engine.numerics.plain import Json
from service.problems import Problem

_ALLOCATION_FAILED = ("can't allocate memory", "insufficient memory", "allocation failed")
"""As torch, OpenCV and numba say it, none of them with a MemoryError."""


def describe(error: BaseException, request: Mapping[str, Any] | None = None) -> Json:
    """`kind`, `detail` and further members of an error.

    Paths that the request named are cut down to their last part: where this machine keeps its files is no business
    of the client's.
    """
    plain = _describe(error)
    for path in sorted(_paths(request or {}), key=len, reverse=True):
        plain["detail"] = plain["detail"].replace(path, PurePath(path).name)
    return plain


def _describe(error: BaseException) -> Json:
    text = " ".join(str(error).split())
    if isinstance(error, Problem):
        return {"kind": error.kind, "detail": error.detail, **error.extra}
    if isinstance(error, FormatError):
        place = {"element": error.element, "row": error.row, "property": error.prop}
        known = {name: value for name, value in place.items() if value is not None}
        where = ", ".join(f"{name} {value!r}" for name, value in known.items())
        return {"kind": "unreadable-model", "detail": f"{where}: {error.message}" if where else error.message, **known}
    if isinstance(error, CameraError):
        return {"kind": "unreadable-cameras", "detail": text}
    if isinstance(error, CapacityError):
        return {"kind": "capacity", "detail": text, "wanted": error.wanted, "capacity": error.capacity}
    if isinstance(error, (InputError, KeyFileError)):
        return {"kind": "invalid-request", "detail": text}
    if isinstance(error, MemoryError) or any(sign in text.lower() for sign in _ALLOCATION_FAILED):
        return {"kind": "engine-limit", "detail": "the work needed more memory than it may have"}
    if isinstance(error, OSError) and error.errno == errno.EFBIG:
        return {"kind": "engine-limit", "detail": "the work wrote a larger file than it may"}
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return {"kind": "storage-full", "detail": "no space left for the files of this work"}
    return {"kind": "internal", "detail": f"the work failed by a fault of this service ({type(error).__name__})"}


def _paths(value: Any) -> Iterator[str]:
    if isinstance(value, str) and value.startswith("/") and len(value) > 1:
        yield value
    elif isinstance(value, (Mapping, list, tuple)):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from _paths(item)
