"""Lists before or among the Gaussians of a PLY: where all rows have one length, they are plain properties."""

import io
from dataclasses import replace
from itertools import islice

import numpy as np

from engine.formats.ply.header import Element, Header, Property

_LONGEST, _LONGEST_NAME = 64, 70


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
    first = _first_row(data, header, element, offset)
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


def _first_row(data: bytes | memoryview, header: Header, element: Element, offset: int) -> list[int]:
    """For each property the length of its list, `_LONGEST` + 1 where there is none; 0 of what is no list."""
    words: list[bytes] = []
    if not header.byte_order:
        before = sum(e.count for e in header.elements[: header.elements.index(element)])
        words = next(islice(io.BytesIO(data[header.size :]), before, None), b"").split(None, _LONGEST * 64)
    lengths, at = [], 0
    for prop in element.properties:
        length = 0
        if prop.is_list:
            try:
                code = header.byte_order + prop.code
                length = int(np.frombuffer(data, code, 1, offset + at)[0]) if header.byte_order else int(words[at])
            except (ValueError, IndexError):
                length = -1
            length = length if 0 <= length <= _LONGEST else _LONGEST + 1
        lengths.append(length)
        at += int(prop.code[1]) + length * int(prop.item[1:] or 0) if header.byte_order else 1 + length
    return lengths
