"""What goes wrong, as one line for people, as JSON for machines, and as an exit code."""

from engine.errors import CapacityError, FormatError, Mark3DGSError
from engine.numerics.plain import Json

MARKED = OK = 0
FAILED = 1
"""A fault of this program or of the machine (out of memory, disk full)."""
USAGE = 2
NOT_MARKED = 3
INCONCLUSIVE = 4
INTERRUPTED = 130

VERDICT_CODES = {"marked": MARKED, "not_marked": NOT_MARKED, "inconclusive": INCONCLUSIVE}

_USAGE_OS_ERRORS = (FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError, FileExistsError)


def exit_code(error: BaseException) -> int:
    """Exit code of the program when this error ends it."""
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, (Mark3DGSError, *_USAGE_OS_ERRORS)) or _is_usage_error(error):
        return USAGE
    return FAILED


def describe(error: BaseException) -> Json:
    """The error as plain values: `type`, `message`, and the numbers and names it carries.

    FormatError adds those of `file`, `element`, `row`, `property` that it knows; CapacityError adds `wanted` and
    `capacity`, in bits.
    """
    if isinstance(error, KeyboardInterrupt):
        return {"type": "Interrupted", "message": "interrupted; nothing was written"}
    if _is_usage_error(error):
        return {"type": "UsageError", "message": _one_line(error.format_message())}  # type: ignore[attr-defined]  # click's, found by name
    found: Json = {"type": type(error).__name__, "message": _message(error)}
    if isinstance(error, FormatError):
        place = {"file": error.file or None, "element": error.element, "row": error.row, "property": error.prop}
        found |= {name: value for name, value in place.items() if value is not None}
    if isinstance(error, CapacityError):
        found |= {"wanted": error.wanted, "capacity": error.capacity}
    return found


def _message(error: BaseException) -> str:
    if isinstance(error, Mark3DGSError):
        return _one_line(str(error))
    if isinstance(error, OSError):
        reason = error.strerror or str(error)
        return _one_line(f"{error.filename}: {reason}" if error.filename else reason)
    if isinstance(error, MemoryError):
        return "out of memory"
    return _one_line(f"internal error, please report it: {type(error).__name__}: {error}")


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _is_usage_error(error: BaseException) -> bool:
    # typer brings its own copy of click from some version on: the two families share their methods, no base.
    return hasattr(error, "format_message") and hasattr(error, "exit_code")
