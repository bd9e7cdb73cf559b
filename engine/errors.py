"""Every error the engine raises on purpose.

    Mark3DGSError
    |-- InputError                 the caller's file, argument or option is wrong       (exit code 2)
    |   |-- FormatError            a file's bytes do not say what its header claims
    |   |   `-- UnsupportedFormatError   a format (or version of one) that is not read here
    |   `-- CameraError            a camera file or a camera is unusable
    |-- KeyFileError               an owner key is missing, too short or would be overwritten
    |-- RecordError
    |   |-- MalformedRecordError   the bytes are no record
    |   |-- RecordTooNewError      a later version of this program wrote it
    |   `-- WrongKeyError          a whole record, sealed under another key
    `-- CapacityError              the planner refuses: the scene cannot carry that message

"No mark found" is a result, not an error.
"""


class Mark3DGSError(Exception):
    """Base of all errors raised on purpose; its text is fit for the user's eyes."""


class InputError(Mark3DGSError):
    """A file, argument or option of the caller is wrong."""


class FormatError(InputError):
    """A file, named as the user gave it, cannot be read as what it claims to be.

    The message says what is wrong, with the offending value; element and property (of the file format) and row (a
    Gaussian, counted from 0) say where.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str = "",
        element: str | None = None,
        row: int | None = None,
        prop: str | None = None,
    ) -> None:
        self.message, self.file, self.element, self.row, self.prop = message, file, element, row, prop
        where = [file] if file else []
        where += [f"element {element!r}"] if element is not None else []
        where += [f"row {row}"] if row is not None else []
        where += [f"property {prop!r}"] if prop is not None else []
        super().__init__(f"{', '.join(where)}: {message}" if where else message)


class UnsupportedFormatError(FormatError):
    """A format, or a version of one, that this program does not read or write."""


class CameraError(InputError):
    """A camera file or a camera is unusable."""


class KeyFileError(Mark3DGSError):
    """An owner key is missing, malformed, too short, or would be overwritten."""


class RecordError(Mark3DGSError):
    """A record cannot be used."""


class MalformedRecordError(RecordError):
    """The bytes are not a record of this program, or were damaged."""


class RecordTooNewError(RecordError):
    """The record was written by a later version of this program."""


class WrongKeyError(RecordError):
    """The record is whole, but sealed under another key."""


class CapacityError(Mark3DGSError):
    """The planner refuses a message of `wanted` bits: the scene can carry `capacity` at the fidelity requested."""

    def __init__(self, message: str, *, wanted: int, capacity: int) -> None:
        super().__init__(message)
        self.wanted, self.capacity = wanted, capacity
