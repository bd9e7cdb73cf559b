"""Lists of a PLY: before or among the Gaussians, plain properties where all rows have one length; those of faces."""

import io
import struct
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.ply.header import Element, Header, Property

_LONGEST, _LONGEST_NAME = 64, 70
_MOST_ROWS = 1 << 24  # of several lengths: ten seconds


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
        first = _first_lengths(data, header, replace(element, count=1), offset)
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


def _first_lengths(data: bytes | memoryview, header: Header, one: Element, offset: int) -> list[int]:
    """For each property of an element of one row, the number of its values."""
    order = header.byte_order
    if not order:
        names = [e.name for e in header.elements]
        before = sum(e.count for e in header.elements[: names.index(one.name)])
        data, order, offset = _packed(data[header.size :], one, before, ""), "<", 0
    return [length for _, length, _ in _values(data, order, one, offset, "")]


def end_of_rows(data: bytes | memoryview, header: Header, element: Element, offset: int, *, file: str) -> int:
    """Where the rows of an element of a binary file end that begin at the offset; FormatError if they are cut off."""
    end = offset + element.count * element.stride
    for place, length, size in _values(data, header.byte_order, element, offset, file) if element.has_lists else ():
        end = place + length * size
    if end > len(data):
        raise FormatError("its rows are cut off", file=file, element=element.name)
    return end


def read_lists(
    data: bytes | memoryview, header: Header, element: Element, *, file: str
) -> dict[str, tuple[npt.NDArray[np.int64], npt.NDArray[Any]]]:
    """Of each property of an element of at least one row: the number of values of each row, and all values.

    FormatError if the rows, or others before them, are cut off, or a line of an ASCII file is none.
    """
    before = header.elements[: header.elements.index(element)]
    offset = header.size
    if not header.byte_order:
        data, offset = _packed(data[offset:], element, sum(each.count for each in before), file), 0
        header, before = replace(header, byte_order="<", size=0, elements=(element,)), ()
    for each in before:
        offset = end_of_rows(data, header, each, offset, file=file)
    plain = _plain(data, header, element, offset)
    wide = len(element.properties)
    if plain.has_lists or offset + element.count * plain.stride > len(data):
        flat = np.fromiter(_values(data, header.byte_order, element, offset, file), np.dtype((np.int64, 3)))
    else:  # rows of one length: as the first one
        one = replace(header, elements=(replace(element, count=1),))
        first = list(_values(data, header.byte_order, one.elements[0], offset, file))
        flat = (np.arange(element.count)[:, None, None] * [plain.stride, 0, 0] + np.array(first)).reshape(-1, 3)
    found = {}
    for k, prop in enumerate(element.properties):
        places, lengths, sizes = flat[k::wide].T
        within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        code = np.dtype(header.byte_order + (prop.item or prop.code))
        # One value at every byte: rows of a file are not aligned.
        everywhere = np.ndarray((max(len(data) - code.itemsize + 1, 0),), code, data, 0, (1,))
        found[prop.name] = lengths, everywhere[np.repeat(places, lengths) + within * sizes[0]]
    return found


def _values(
    data: bytes | memoryview, order: str, element: Element, offset: int, file: str
) -> Iterator[tuple[int, int, int]]:
    """Row after row, and in it property after property: where its values begin, their number, and the bytes of one."""
    if element.count > _MOST_ROWS:
        message = f"{element.count} rows with lists of different lengths: export without them"
        raise FormatError(message, file=file, element=element.name)
    kinds = [
        (struct.Struct(order + np.dtype(p.code).char) if p.is_list else None, int((p.item or p.code)[1:]))
        for p in element.properties
    ]
    at = offset
    try:
        for _ in range(element.count):
            for counted, size in kinds:
                length = 1
                if counted:
                    length = int(counted.unpack_from(data, at)[0])
                    at += counted.size
                yield at, length, size
                at += length * size
                if length < 0 or at > len(data):
                    raise ValueError
    except (struct.error, ValueError, OverflowError):
        message = f"a list at byte {at} is cut off, or its length is wrong"
        raise FormatError(message, file=file, element=element.name) from None


def _packed(body: bytes | memoryview, element: Element, before: int, file: str) -> bytes:
    """The lines of an element, after so many others, as a binary file has them."""
    packed, row = bytearray(), 0
    lines = islice((line for line in io.BytesIO(body) if line.strip()), before, before + element.count)
    try:
        for row, line in enumerate(lines):
            words = line.split()
            for prop in element.properties:
                length = 1
                if prop.is_list:
                    length = int(words.pop(0))
                    packed += np.array(length, "<" + prop.code).tobytes()
                values, words = words[:length], words[length:]
                packed += np.array(values, "<" + (prop.item or prop.code)).tobytes()
                if len(values) < length:
                    raise ValueError
    except (ValueError, IndexError, OverflowError):
        raise FormatError("the line is no such row", file=file, element=element.name, row=row) from None
    return bytes(packed)
