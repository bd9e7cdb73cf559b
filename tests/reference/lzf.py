"""LZF the slow, obvious way, both directions."""

from __future__ import annotations


def compress(data: bytes) -> bytes:
    """Greedy: the longest earlier match within 8 KiB, else one more byte as it is."""
    out, plain, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(plain), 32):
            piece = plain[start : start + 32]
            out.append(len(piece) - 1)
            out.extend(piece)
        plain.clear()

    while at < len(data):
        best, source = 0, 0
        for start in range(max(0, at - 8192), at):
            length = 0
            while at + length < len(data) and length < 264 and data[start + length] == data[at + length]:
                length += 1
            if length > best:
                best, source = length, start
        if best < 3:
            plain.append(data[at])
            at += 1
            continue
        flush()
        distance = at - source - 1
        if best < 9:
            out.append((best - 2) << 5 | distance >> 8)
        else:
            out += bytes([7 << 5 | distance >> 8, best - 9])
        out.append(distance & 255)
        at += best
    flush()
    return bytes(out)


def decompress(data: bytes) -> bytes:
    """The whole stream; IndexError where it ends early."""
    out, at = bytearray(), 0
    while at < len(data):
        control = data[at]
        at += 1
        if control < 32:
            out += bytes(data[at + k] for k in range(control + 1))
            at += control + 1
            continue
        length = (control >> 5) + 2
        if length == 9:
            length += data[at]
            at += 1
        distance = (control & 31) * 256 + data[at] + 1
        at += 1
        for _ in range(length):
            out.append(out[len(out) - distance])
    return bytes(out)
