"""The tree against its slow twin, and proofs that prove nothing else."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.records import merkle
from engine.records.merkle import Node
from tests.reference import merkle as twin

LEAVES = st.lists(st.binary(max_size=8), min_size=1, max_size=70)


class Store:
    """Perfect subtrees as the log keeps them; counts what is read."""

    def __init__(self, leaves: list[bytes]) -> None:
        self.hashes: dict[Node, bytes] = {}
        self.count = 0
        for index, leaf in enumerate(leaves):
            for level, position in merkle.completed_by(index):
                self.hashes[level, position] = (
                    merkle.node_hash(self.hashes[level - 1, 2 * position], self.hashes[level - 1, 2 * position + 1])
                    if level
                    else merkle.leaf_hash(leaf)
                )

    def __call__(self, nodes: list[Node]) -> dict[Node, bytes]:
        self.count += len(nodes)
        return {node: self.hashes[node] for node in nodes}


@given(LEAVES)
def test_roots_are_the_twins(leaves: list[bytes]) -> None:
    store = Store(leaves)
    for size in range(len(leaves) + 1):  # of every earlier tree too, from the same nodes
        assert merkle.root(size, store) == twin.tree_hash(leaves[:size])


@given(LEAVES, st.data())
def test_proofs_are_the_twins_and_hold(leaves: list[bytes], data: st.DataObject) -> None:
    size = data.draw(st.integers(1, len(leaves)))
    index = data.draw(st.integers(0, size - 1))
    proof = merkle.inclusion_proof(index, size, Store(leaves))
    assert proof == twin.path(index, leaves[:size])
    leaf, root = merkle.leaf_hash(leaves[index]), twin.tree_hash(leaves[:size])
    assert merkle.check_inclusion(leaf, index, size, proof, root)


@given(st.integers(-2, 80), st.integers(-2, 80), st.lists(st.binary(min_size=32, max_size=32), max_size=8), LEAVES)
def test_any_proof_is_judged_as_the_twin_judges_it(
    index: int, size: int, proof: list[bytes], leaves: list[bytes]
) -> None:
    try:
        expected = twin.root_from_path(leaves[0], index, size, proof) if 0 <= index < size else None
    except IndexError:
        expected = None
    leaf = merkle.leaf_hash(leaves[0])
    assert not merkle.check_inclusion(leaf, index, size, proof, bytes(32))
    if expected is not None:
        assert merkle.check_inclusion(leaf, index, size, proof, expected)


@given(LEAVES, st.data())
def test_a_changed_proof_proves_nothing(leaves: list[bytes], data: st.DataObject) -> None:
    size = len(leaves)
    index = data.draw(st.integers(0, size - 1))
    proof = merkle.inclusion_proof(index, size, Store(leaves))
    leaf, root = merkle.leaf_hash(leaves[index]), twin.tree_hash(leaves)
    for other in range(size):
        same = leaves[other] == leaves[index] and twin.path(other, leaves) == proof
        assert merkle.check_inclusion(leaf, other, size, proof, root) == (other == index or same)
    assert not merkle.check_inclusion(leaf, index, size, [*proof, root], root)
    if proof:
        assert not merkle.check_inclusion(leaf, index, size, proof[:-1], root)
        spot = data.draw(st.integers(0, len(proof) - 1))
        bent = [*proof[:spot], bytes([proof[spot][0] ^ 1]) + proof[spot][1:], *proof[spot + 1 :]]
        assert not merkle.check_inclusion(leaf, index, size, bent, root)


def test_a_leaf_does_not_pass_for_a_node() -> None:
    left, right = merkle.leaf_hash(b"a"), merkle.leaf_hash(b"b")
    assert merkle.leaf_hash(left + right) != merkle.node_hash(left, right)


def test_proofs_ask_for_few_nodes() -> None:
    store = Store([bytes([k % 256]) for k in range(5000)])
    merkle.inclusion_proof(0, 4999, store)
    assert store.count <= 26  # 2 log2(n)


def test_known_answer() -> None:
    """Roots published with RFC 6962's reference implementation (Certificate Transparency)."""
    leaves = [
        bytes.fromhex(text)
        for text in ("", "00", "10", "2021", "3031", "40414243", "5051525354555657", "606162636465666768696a6b6c6d6e6f")
    ]
    store = Store(leaves)
    assert merkle.root(0, store).hex() == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert merkle.root(1, store).hex() == "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d"
    assert merkle.root(8, store).hex() == "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328"


@pytest.mark.parametrize(("index", "size"), [(-1, 3), (3, 3), (0, 0)])
def test_leaves_outside_have_no_proof(index: int, size: int) -> None:
    with pytest.raises(ValueError, match="is not in a tree"):
        merkle.inclusion_proof(index, size, Store([b"a", b"b", b"c"]))


@given(LEAVES, st.data())
def test_beginnings_are_proven_as_the_twin_does_and_nothing_else_is(leaves: list[bytes], data: st.DataObject) -> None:
    size = data.draw(st.integers(1, len(leaves)))
    first = data.draw(st.integers(1, size))
    proof = merkle.consistency_proof(first, size, Store(leaves))
    assert proof == twin.proof(first, leaves[:size])
    old, new = twin.tree_hash(leaves[:first]), twin.tree_hash(leaves[:size])
    assert merkle.check_consistency(first, old, size, proof, new)
    for wrong in (merkle.node_hash(old, new), twin.tree_hash([*leaves[: first - 1], b"another"])):
        if wrong != old:
            assert not merkle.check_consistency(first, wrong, size, proof, new)
        if wrong != new:
            assert not merkle.check_consistency(first, old, size, proof, wrong)
    assert not merkle.check_consistency(first, old, size, [*proof, old], new)
    for number in range(len(proof)):
        assert not merkle.check_consistency(first, old, size, proof[:number] + proof[number + 1 :], new)
        changed = [*proof[:number], merkle.node_hash(proof[number], old), *proof[number + 1 :]]
        assert not merkle.check_consistency(first, old, size, changed, new)


@given(st.integers(-2, 80), st.integers(-2, 80), st.lists(st.binary(min_size=32, max_size=32), max_size=8))
def test_a_made_up_proof_proves_no_beginning(first: int, size: int, proof: list[bytes]) -> None:
    old, new = merkle.leaf_hash(b"old"), merkle.leaf_hash(b"new")
    assert not merkle.check_consistency(first, old, size, proof, new)
    for sizes in ((0, 5), (6, 5)):
        with pytest.raises(ValueError, match="not the beginning"):
            merkle.consistency_proof(*sizes, Store([b"x"] * 6))
