"""The text at the head of a PLY file: which elements follow, how many rows, of which scalar properties."""

import re
from dataclasses import dataclass

import numpy as np

from engine.errors import FormatError, UnsupportedFormatError

MAX_HEADER_BYTES = 1 << 16
"""INRIA's header has 1.5 KB; a longer one is refused before anything else is looked at."""

_CODES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_SCALAR_TYPES = _CODES | {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_SCALAR_TYPES |= {"half": "f2", "float16": "f2", "int64": "i8", "uint64": "u8", "bool": "u1"}
_SCALAR_TYPES |= {f"{'u' * (code[0] == 'u')}int{8 * int(code[1])}": code for code in _CODES.values()}
"""What PLY calls its types, old names and new, and how numpy spells them."""

TYPE_NAMES = {code: name for name, code in _CODES.items()} | {"f2": "half", "f4": "float", "f8": "double"}
TYPE_NAMES |= {"i8": "int64", "u8": "uint64"}
"""What PLY calls numpy's types; no name is longer than the other of its kind."""

_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_COUNT = re.compile(r"[0-9]{1,15}", re.ASCII)
_NAME = re.compile(r"[^\x00-\x20\x7f]{1,80}")
ANY_BYTES = ("utf-8", "surrogateescape")
"""How names and comments are decoded, and encoded again: what is no UTF-8 comes back as it was."""


@dataclass(frozen=True)
class Property:
    """A named scalar of an element, of a type as numpy spells it without byte order: ``"f4"``.

    Of a list it is the type of its length, and `item` that of its values: rows may differ in length then.
    """

    name: str
    code: str
    item: str = ""

    @property
    def is_list(self) -> bool:
        """Whether a row has any number of values of it."""
        return bool(self.item)


@dataclass(frozen=True)
class Element:
    """A table of the file: rows that the header announces, and uniquely named properties in the order of the file."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def names(self) -> frozenset[str]:
        """Names of all properties."""
        return frozenset(p.name for p in self.properties)

    @property
    def has_lists(self) -> bool:
        """Whether some property is a list, so that rows have no fixed length."""
        return any(p.is_list for p in self.properties)

    @property
    def stride(self) -> int:
        """Bytes of a row in a binary file; with lists, the least a row can have."""
        return sum(int(p.code[1]) for p in self.properties)

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Packed record type of a row; byte_order is ``"<"`` or ``">"``."""
        return np.dtype([(p.name, byte_order + p.code) for p in self.properties])


@dataclass(frozen=True)
class Header:
    """A parsed header: ``"<"`` or ``">"`` for binary files, empty for ASCII; uniquely named elements in the order of
    the file; its length in bytes, up to and with the newline after ``end_header``; the comments, a character a byte."""

    byte_order: str
    elements: tuple[Element, ...]
    size: int
    comments: tuple[str, ...] = ()

    def element(self, name: str) -> Element | None:
        """The element of that name."""
        return next((e for e in self.elements if e.name == name), None)


def parse_header(data: bytes | memoryview, *, file: str) -> Header:
    """Read the header of a PLY file, whole or its first 64 KiB; allocates nothing that depends on the counts in it.

    FormatError if it is longer than 64 KiB, broken, or announces something twice; UnsupportedFormatError if it has a
    version other than 1.0.
    """
    head = bytes(data[:MAX_HEADER_BYTES])
    if not head.startswith((b"ply\n", b"ply\r")):
        raise FormatError("is no PLY file: the first line is not 'ply'", file=file)
    parser = _Parser(file)
    ends = b"\r" if head[3:4] == b"\r" and head[4:5] != b"\n" else b"\n"
    start = head.index(ends) + 1
    while (end := head.find(ends, start)) >= 0:
        line, start = head[start:end].removesuffix(b"\r"), end + 1
        if line.strip() == b"end_header":
            return parser.finish(start)
        parser.take(line)
    what = "is cut off" if len(data) < MAX_HEADER_BYTES else f"is longer than {MAX_HEADER_BYTES} bytes"
    raise FormatError(f"the header {what}: no line 'end_header'", file=file)


class _Parser:
    """Takes the lines of a header one by one."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.byte_order: str | None = None
        self.tables: dict[str, tuple[int, dict[str, Property]]] = {}
        self.current: str | None = None
        self.comments: list[str] = []

    def take(self, line: bytes) -> None:
        words = [word.decode(*ANY_BYTES) for word in line.split()]
        if not words:
            return
        keyword = words[0].lower()
        if keyword in ("comment", "obj_info"):
            self.comments.append(line.strip().partition(words[0].encode())[2].strip().decode(*ANY_BYTES))
            return
        if keyword == "format" and len(words) == 3:
            self._format(words[1], words[2])
        elif keyword == "element" and len(words) == 3:
            self._element(words[1], words[2])
        elif keyword == "property" and len(words) == 3:
            self._property(Property(words[2], self._type(words[1], words[2])))
        elif keyword == "property" and len(words) == 5 and words[1] == "list":
            self._property(Property(words[4], self._type(words[2], words[4]), self._type(words[3], words[4])))
        else:
            raise self._fault(f"cannot read the header line {_show(line.decode(*ANY_BYTES))}")

    def finish(self, size: int) -> Header:
        if self.byte_order is None:
            raise self._fault("the header has no 'format' line")
        if not self.tables:
            raise self._fault("the header announces no element")
        elements = []
        for name, (count, properties) in self.tables.items():
            if not properties:
                raise FormatError("has no properties", file=self.file, element=name)
            elements.append(Element(name, count, tuple(properties.values())))
        return Header(self.byte_order, tuple(elements), size, tuple(self.comments))

    def _format(self, encoding: str, version: str) -> None:
        if self.byte_order is not None:
            raise self._fault("the header has two 'format' lines")
        if encoding not in _BYTE_ORDERS:
            raise self._fault(f"unknown encoding {_show(encoding)}")
        if version != "1.0":
            raise UnsupportedFormatError(f"PLY version {_show(version)} is not read here, only 1.0", file=self.file)
        self.byte_order = _BYTE_ORDERS[encoding]

    def _element(self, name: str, count: str) -> None:
        self._check_name(name)
        if name in self.tables:
            raise FormatError("announced twice", file=self.file, element=name)
        if not _COUNT.fullmatch(count):
            raise FormatError(f"{_show(count)} is no number of rows", file=self.file, element=name)
        self.tables[name] = (int(count), {})
        self.current = name

    def _property(self, prop: Property) -> None:
        self._check_name(prop.name)
        if self.current is None:
            raise FormatError("announced before any element", file=self.file, prop=prop.name)
        properties = self.tables[self.current][1]
        if prop.name in properties:
            raise FormatError("announced twice", file=self.file, element=self.current, prop=prop.name)
        properties[prop.name] = prop

    def _type(self, name: str, prop: str) -> str:
        if name.lower() not in _SCALAR_TYPES:
            raise FormatError(f"unknown type {_show(name)}", file=self.file, element=self.current, prop=prop[:40])
        return _SCALAR_TYPES[name.lower()]

    def _check_name(self, name: str) -> None:
        if not _NAME.fullmatch(name):
            raise self._fault(f"{_show(name)} cannot be a name")

    def _fault(self, message: str) -> FormatError:
        return FormatError(message, file=self.file, element=self.current)


def _show(text: str) -> str:
    """Untrusted text, made harmless for a message."""
    return ascii(text if len(text) <= 40 else text[:37] + "...")
