"""The tables of a PLY file as numpy records, binary of either byte order or ASCII; no more than is there."""

import io
import re
from collections.abc import Iterator
from itertools import islice

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.ply.header import Element, Header
from engine.formats.ply.lists import end_of_rows

_LINES_AT_ONCE = 4096
_WINDOWS = re.compile(r"[-+]?(nan\((ind|snan)\)|1\.#(ind|inf|qnan|snan)\d*)", re.IGNORECASE)
"""What its C library writes for values that are no finite numbers."""


def read_tables(
    data: bytes | memoryview, header: Header, wanted: list[str], *, file: str
) -> dict[str, npt.NDArray[np.void]]:
    """(count,) records of the elements wanted, which the header has; others are skipped.

    That rows times bytes a row is what follows the header is checked first. Of a binary file they are views on its
    bytes in its byte order. FormatError if there is less, or more, than the header announces, a line of an ASCII file
    is not what it should be (with its row and property), or an element wanted has lists.
    """
    for name, prop in ((e.name, p) for e in header.elements if e.name in wanted for p in e.properties if p.is_list):
        raise FormatError("lists of different lengths: export without them", file=file, element=name, prop=prop.name)
    if not header.byte_order:
        return _read_ascii(data, header, wanted, file)
    length = header.size + sum(element.count * element.stride for element in header.elements)
    ends_as_text = bytes(data[length : length + 3]) in (b"\n", b"\r\n")
    offsets = _locate(data, header, length if ends_as_text else len(data), wanted[-1], file)
    found = (e for e in header.elements if e.name in wanted)
    return {e.name: np.frombuffer(data, e.dtype(header.byte_order), e.count, offsets[e.name]) for e in found}


def _locate(data: bytes | memoryview, header: Header, length: int, until: str, file: str) -> dict[str, int]:
    """Offset of every element up to the one called `until`, once all bytes are known to be there.

    With lists after it, which are skipped, the rest must only be long enough.
    """
    offsets: dict[str, int] = {}
    offset, open_end = header.size, False
    for element in header.elements:
        offsets[element.name] = offset
        open_end = open_end or (element.has_lists and until in offsets)
        offset += element.count * element.stride
        if element.has_lists and not open_end and offset <= length:
            offset = end_of_rows(data, header, element, offsets[element.name], file=file)
        if offset > length:
            there = length - (offset - element.count * element.stride)
            message = (
                f"the header announces {element.count} rows of {element.stride} bytes, "
                f"but only {max(there, 0)} bytes are there: cut off, or the count is wrong"
            )
            row = max(there, 0) // element.stride if element.stride else None
            raise FormatError(message, file=file, element=element.name, row=row)
    if offset < length and not open_end:
        last = header.elements[-1]
        message = f"{length - offset} bytes follow the {last.count} rows of the last element: the count is wrong"
        raise FormatError(message, file=file, element=last.name)
    return offsets


def _read_ascii(
    data: bytes | memoryview, header: Header, wanted: list[str], file: str
) -> dict[str, npt.NDArray[np.void]]:
    body = data[header.size :]
    for element in header.elements:  # a digit and a separator each: known before anything is allocated
        least = 2 * element.count * len(element.properties) - 1
        if least > len(body):
            message = f"the header announces {element.count} rows, but only {len(body)} bytes are there"
            raise FormatError(message, file=file, element=element.name)
    text = io.TextIOWrapper(io.BytesIO(body), encoding="latin-1")
    lines = (_WINDOWS.sub("nan", line) for line in text if line.strip())
    tables = {}
    for element in header.elements:
        if element.name in wanted:
            tables[element.name] = _read_rows(lines, element, file)
        else:
            skipped = sum(1 for _ in islice(lines, element.count))
            if skipped < element.count:
                raise _too_short(element, skipped, file)
    if next(lines, None) is not None:
        last = header.elements[-1]
        message = f"more lines follow the {last.count} rows of the last element: the count is wrong"
        raise FormatError(message, file=file, element=last.name)
    return tables


def _read_rows(lines: Iterator[str], element: Element, file: str) -> npt.NDArray[np.void]:
    records = np.empty(element.count, dtype=element.dtype("<"))
    for start in range(0, element.count, _LINES_AT_ONCE):
        block = list(islice(lines, min(_LINES_AT_ONCE, element.count - start)))
        if not any(block):
            raise _too_short(element, start, file)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                rows = np.loadtxt(block, dtype=records.dtype, comments=None, ndmin=1)
        except (ValueError, OverflowError):
            raise _fault(block, start, element, file) from None
        if len(rows) < len(block):
            raise _fault(block, start, element, file)
        records[start : start + len(rows)] = rows
        if start + len(rows) < element.count and len(block) < _LINES_AT_ONCE:
            raise _too_short(element, start + len(rows), file)
    return records


def _fault(block: list[str], start: int, element: Element, file: str) -> FormatError:
    """The first line of a block that is no row of the element, named."""
    for row, line in enumerate(block, start):
        words = line.split()
        if len(words) != len(element.properties):
            hint = " (separate values by blanks)" if len(words) == 1 else ""
            message = f"the line holds {len(words)} values, expected {len(element.properties)}{hint}"
            return FormatError(message, file=file, element=element.name, row=row)
        for word, prop in zip(words, element.properties, strict=True):
            try:
                np.loadtxt([word], dtype=prop.code, comments=None)
            except (ValueError, OverflowError):
                hint = "separate values by blanks" if word.endswith(",") else "export it with decimal points"
                hint = f" ({hint})" if "," in word else ""
                message = f"{word[:40]!a} is no {np.dtype(prop.code).name}{hint}"
                return FormatError(message, file=file, element=element.name, row=row, prop=prop.name)
    return FormatError("cannot be read", file=file, element=element.name, row=start)


def _too_short(element: Element, rows: int, file: str) -> FormatError:
    message = f"there are only {rows} of the announced {element.count} rows: cut off, or the count is wrong"
    return FormatError(message, file=file, element=element.name, row=rows)
