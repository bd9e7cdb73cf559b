"""Merkle trees as in RFC 6962: roots, proofs of inclusion and of consistency. Pure functions, for log and readers.

A perfect subtree is named by `(level, position)`: it covers the leaves position * 2^level up to, but without,
(position + 1) * 2^level.
"""

from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256

Node = tuple[int, int]
Fetch = Callable[[list[Node]], dict[Node, bytes]]
"""Hashes of perfect subtrees by name; raises where one is missing."""

EMPTY_ROOT = sha256(b"").digest()


def leaf_hash(leaf: bytes) -> bytes:
    """Hash of a leaf; the prefix keeps leaves and nodes apart."""
    return sha256(b"\x00" + leaf).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """Hash of an inner node."""
    return sha256(b"\x01" + left + right).digest()


def completed_by(index: int) -> Iterator[Node]:
    """Perfect subtrees that the leaf `index` completes, smallest first; the leaf itself is the first."""
    level = 0
    yield 0, index
    while index >> level & 1:
        level += 1
        yield level, index >> level


def root(size: int, fetch: Fetch) -> bytes:
    """Root of the first `size` leaves."""
    if size == 0:
        return EMPTY_ROOT
    nodes = _cover(0, size)
    return _join(nodes, fetch(nodes))


def inclusion_proof(index: int, size: int, fetch: Fetch) -> list[bytes]:
    """The hashes that lead from leaf `index` to the root of `size` leaves, lowest first (RFC 6962 2.1.1)."""
    if not 0 <= index < size:
        raise ValueError(f"leaf {index} is not in a tree of {size}")
    low, high, siblings = 0, size, []
    while high - low > 1:
        middle = low + (1 << (high - low - 1).bit_length() - 1)
        if index < middle:
            siblings.append(_cover(middle, high))
            high = middle
        else:
            siblings.append(_cover(low, middle))
            low = middle
    hashes = fetch([node for nodes in siblings for node in nodes])
    return [_join(nodes, hashes) for nodes in reversed(siblings)]


def check_inclusion(leaf: bytes, index: int, size: int, proof: Sequence[bytes], root: bytes) -> bool:
    """Whether the proof leads from the hash of leaf `index` of `size` to the root (RFC 9162 2.1.3.2)."""
    if not 0 <= index < size:
        return False
    here, last, found = index, size - 1, leaf
    for sibling in proof:
        if last == 0:
            return False
        if here & 1 or here == last:
            found = node_hash(sibling, found)
            while not here & 1 and here:
                here, last = here >> 1, last >> 1
        else:
            found = node_hash(found, sibling)
        here, last = here >> 1, last >> 1
    return last == 0 and found == root


def consistency_proof(first: int, size: int, fetch: Fetch) -> list[bytes]:
    """The hashes that show the tree of `first` leaves to be the beginning of the tree of `size` (RFC 6962 2.1.2)."""
    if not 0 < first <= size:
        raise ValueError(f"a tree of {first} leaves is not the beginning of one of {size}")
    low, high, parts = 0, size, []
    while high != first:
        middle = low + (1 << (high - low - 1).bit_length() - 1)
        if first <= middle:
            parts.append(_cover(middle, high))
            high = middle
        else:
            parts.append(_cover(low, middle))
            low = middle
    if low:  # else what is left is the first tree, whose root the reader has
        parts.append(_cover(low, high))
    hashes = fetch([node for nodes in parts for node in nodes])
    return [_join(nodes, hashes) for nodes in reversed(parts)]


def check_consistency(first: int, first_root: bytes, size: int, proof: Sequence[bytes], root: bytes) -> bool:
    """Whether the proof shows the tree of `first` leaves under `first_root` to be the beginning of the tree of `size`
    under `root` (RFC 9162 2.1.4.2)."""
    if not 0 < first <= size:
        return False
    if first == size:
        return not proof and first_root == root
    steps = [first_root, *proof] if first & (first - 1) == 0 else list(proof)
    if not steps:
        return False
    here, last = first - 1, size - 1
    while here & 1:
        here, last = here >> 1, last >> 1
    old = new = steps[0]
    for step in steps[1:]:
        if last == 0:
            return False
        if here & 1 or here == last:
            old, new = node_hash(step, old), node_hash(step, new)
            while not here & 1 and here:
                here, last = here >> 1, last >> 1
        else:
            new = node_hash(new, step)
        here, last = here >> 1, last >> 1
    return last == 0 and old == first_root and new == root


def _cover(low: int, high: int) -> list[Node]:
    """The fewest perfect subtrees that make up the leaves low to high, left to right, where low is as aligned
    as any range that RFC 6962 splits off."""
    nodes = []
    while low < high:
        level = (high - low).bit_length() - 1
        nodes.append((level, low >> level))
        low += 1 << level
    return nodes


def _join(nodes: list[Node], hashes: dict[Node, bytes]) -> bytes:
    found = hashes[nodes[-1]]
    for node in reversed(nodes[:-1]):
        found = node_hash(hashes[node], found)
    return found
