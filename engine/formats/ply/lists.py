"""Lists of a PLY: before or among the Gaussians, plain properties where all rows have one length; those of faces."""

import io
import struct
from array import array
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.ply.header import Element, Header, Property

_LONGEST, _LONGEST_NAME = 64, 70
_MOST_ROWS = 1 << 23  # of different lengths that are passed over: in ten seconds


def plain_lists(data: bytes | memoryview, header: Header, last: str) -> Header:
    """The header with lists as their length and their items (``name``, ``name[0]``, ...), of the elements up to the
    one called `last`. Those whose rows differ in length, or are longer than 64 items, stay lists."""
    elements = list(header.elements)
    offset = header.size
    for at, element in enumerate(elements):
        if element.has_lists and element.count:
            elements[at] = _plain(data, header, element, offset)
        offset += element.count * elements[at].stride
        if element.name == last or elements[at].has_lists:
            break
    return replace(header, elements=tuple(elements))


def _plain(data: bytes | memoryview, header: Header, element: Element, offset: int) -> Element:
    try:
        first = [len(values) for values in next(_rows(data, header, element, offset, ""))]
    except FormatError:  # it is reported when its rows are read
        return element
    properties: list[Property] = []
    for prop, length in zip(element.properties, first, strict=True):
        properties.append(Property(prop.name, prop.code))
        if prop.is_list:
            if length > _LONGEST or len(prop.name) > _LONGEST_NAME:
                return element
            properties += [Property(f"{prop.name}[{i}]", prop.item) for i in range(length)]
    plain = replace(element, properties=tuple(properties))
    if len(plain.names) < len(properties):
        return element
    if header.byte_order:  # in ASCII files, the reader reports rows of another length
        there = min(element.count, max(len(data) - offset, 0) // plain.stride)
        rows = np.frombuffer(data, plain.dtype(header.byte_order), there, offset)
        if any((rows[p.name] != n).any() for p, n in zip(element.properties, first, strict=True) if p.is_list):
            return element
    return plain


def end_of_rows(data: bytes | memoryview, header: Header, element: Element, offset: int, *, file: str) -> int:
    """Where the rows of an element of a binary file end that begin at the offset; FormatError if they are cut off, or
    too many to be passed over one by one."""
    end = offset + element.count * element.stride
    if element.has_lists and element.count > _MOST_ROWS:
        message = f"{element.count} rows with lists of different lengths: export without them"
        raise FormatError(message, file=file, element=element.name)
    items = [int(p.item[1]) if p.is_list else 0 for p in element.properties]
    for row in _rows(data, header, element, offset, file) if element.has_lists else ():
        end += sum(len(values) * size for values, size in zip(row, items, strict=True))
    return end


def read_lists(
    data: bytes | memoryview, header: Header, element: Element, *, file: str
) -> dict[str, tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]]:
    """Of each property of an element: the number of values of each row, and all values.

    FormatError if the rows, or others before them, are cut off, or a line of an ASCII file is none.
    """
    offset = header.size
    for each in header.elements[: header.elements.index(element)] if header.byte_order else ():
        offset = end_of_rows(data, header, each, offset, file=file)
    found = [(array("q"), array("d")) for _ in element.properties]
    for row in _rows(data, header, element, offset, file):
        for (lengths, all_values), values in zip(found, row, strict=True):
            lengths.append(len(values))
            all_values.extend(values)
    arrays = [(np.array(lengths, np.int64), np.array(values)) for lengths, values in found]
    return {prop.name: each for prop, each in zip(element.properties, arrays, strict=True)}


def _rows(
    data: bytes | memoryview, header: Header, element: Element, offset: int, file: str
) -> Iterator[list[tuple[Any, ...]]]:
    """The values of each property, row after row; in a binary file from the offset."""
    order, number = header.byte_order, 0
    with suppress(struct.error, ValueError, OverflowError):
        for row in _binary_rows(data, order, element, offset) if order else _text_rows(data, header, element):
            yield row
            number += 1
    if number < element.count:
        message = "is cut off, or the length of a list is wrong"
        raise FormatError(message, file=file, element=element.name, row=number)


def _binary_rows(data: bytes | memoryview, order: str, element: Element, at: int) -> Iterator[list[tuple[Any, ...]]]:
    kinds = [
        (struct.Struct(order + np.dtype(p.code).char) if p.is_list else None, np.dtype(p.item or p.code))
        for p in element.properties
    ]
    for _ in range(element.count):
        row = []
        for counted, kind in kinds:
            length = 1
            if counted:
                (length,) = counted.unpack_from(data, at)
                at += counted.size
            row.append(struct.unpack_from(f"{order}{length}{kind.char}", data, at))
            at += length * kind.itemsize
        yield row


def _text_rows(data: bytes | memoryview, header: Header, element: Element) -> Iterator[list[tuple[Any, ...]]]:
    before = sum(each.count for each in header.elements[: header.elements.index(element)])
    lines = (line for line in io.BytesIO(data[header.size :]) if line.strip())
    for line in islice(lines, before, before + element.count):
        words, row = iter(line.split()), []
        for prop in element.properties:
            length = int(next(words, b"")) if prop.is_list else 1
            row.append(tuple(map(float, islice(words, length))))
            if len(row[-1]) < length:
                raise ValueError
        yield row
