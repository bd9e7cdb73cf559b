"""Kernels of the bounding-volume hierarchy: insertion by least surface area, removal, box and ray queries.

A tree of L leaves has 2 L - 1 nodes, numbered without gaps. Insertion descends to the sibling that adds the
least surface area and rotates the tree on the way back up (Catto, "Dynamic Bounding Volume Hierarchies", GDC
2019), so that no order of insertion degenerates it.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np

from engine.kernels.jit import inlined, kernel

NONE = -1  # no node
TIE = 1e-12  # gains no farther apart than this, relatively, are equal: the first swap found stays

# Columns of the links (nodes, 4): parent, first child, second child (NONE, NONE in a leaf), item of a leaf.
PARENT, LEFT, RIGHT, ITEM = 0, 1, 2, 3


@inlined
def _union_area(boxes, a, b):
    """Half the surface area of the box around two nodes; a node with itself: of that node."""
    x = max(boxes[a, 3], boxes[b, 3]) - min(boxes[a, 0], boxes[b, 0])
    y = max(boxes[a, 4], boxes[b, 4]) - min(boxes[a, 1], boxes[b, 1])
    z = max(boxes[a, 5], boxes[b, 5]) - min(boxes[a, 2], boxes[b, 2])
    return x * y + y * z + z * x


@inlined
def _refit(boxes, links, node):
    left, right = links[node, LEFT], links[node, RIGHT]
    for a in range(3):
        boxes[node, a] = min(boxes[left, a], boxes[right, a])
        boxes[node, a + 3] = max(boxes[left, a + 3], boxes[right, a + 3])


@inlined
def _hang(links, above, old, new, root):
    """Let `new` take the place of the child `old` of a node, or of the root; the new root."""
    if above == NONE:
        return new
    if links[above, LEFT] == old:
        links[above, LEFT] = new
    else:
        links[above, RIGHT] = new
    return root


@inlined
def _rotate(boxes, links, node):
    """Swap a child with a grandchild of the other side where that shrinks the other child most."""
    best = 0.0
    chosen_child, chosen_grandchild = NONE, NONE
    for side in range(2):
        child = links[node, LEFT + side]
        other = links[node, RIGHT - side]
        if links[other, LEFT] == NONE:
            continue
        for leg in range(2):
            going, staying = links[other, LEFT + leg], links[other, RIGHT - leg]
            gain = _union_area(boxes, other, other) - _union_area(boxes, child, staying)
            if gain > best * (1.0 + TIE):
                best = gain
                chosen_child, chosen_grandchild = child, going
    if chosen_child == NONE:
        return
    other = links[chosen_grandchild, PARENT]
    _hang(links, node, chosen_child, chosen_grandchild, NONE)
    _hang(links, other, chosen_grandchild, chosen_child, NONE)
    links[chosen_grandchild, PARENT] = node
    links[chosen_child, PARENT] = other
    _refit(boxes, links, other)


@kernel
def _insert(boxes, links, root, leaf, inner):
    """Hang a filled-in leaf into the tree, `inner` becoming its parent; the new root."""
    if root == NONE:
        links[leaf, PARENT] = NONE
        return leaf
    # Descend while a child is a better sibling than this node: cost is area added, here and above.
    at = root
    while links[at, LEFT] != NONE:
        joined = _union_area(boxes, at, leaf)
        here = 2.0 * joined
        inherited = 2.0 * (joined - _union_area(boxes, at, at))
        next_at, least = NONE, here
        for side in range(2):
            child = links[at, LEFT + side]
            cost = 2.0 * _union_area(boxes, child, leaf) + inherited
            if links[child, LEFT] != NONE:
                cost -= 2.0 * _union_area(boxes, child, child)
            if cost < least:
                next_at, least = child, cost
        if next_at == NONE:
            break
        at = next_at
    above = links[at, PARENT]
    links[inner, PARENT], links[inner, LEFT], links[inner, RIGHT] = above, at, leaf
    links[inner, ITEM] = NONE
    links[at, PARENT], links[leaf, PARENT] = inner, inner
    root = _hang(links, above, at, inner, root)
    node = inner
    while node != NONE:
        _refit(boxes, links, node)
        _rotate(boxes, links, node)
        node = links[node, PARENT]
    return root


@kernel
def insert_all(boxes, links, root, leaves, lows, highs, items, start):
    """Insert boxes as nodes start.. of arrays that are long enough; a tree of L leaves has 2 L - 1 nodes."""
    free = start
    for i in range(leaves):
        leaf = free
        free += 1
        inner = free
        if root != NONE:
            free += 1
        for a in range(3):
            boxes[leaf, a] = lows[i, a]
            boxes[leaf, a + 3] = highs[i, a]
        links[leaf, LEFT], links[leaf, RIGHT], links[leaf, ITEM] = NONE, NONE, items[i]
        root = _insert(boxes, links, root, leaf, inner)
    return root


@inlined
def _push(stack, depth, links, node):
    stack[depth], stack[depth + 1] = links[node, LEFT], links[node, RIGHT]
    return depth + 2


@kernel(allocates=True)
def overlapping(boxes, links, root, low, high):
    """Items whose box touches the box low..high."""
    stack = np.empty(len(links) + 1, np.int64)
    found = np.empty(len(links), np.int64)
    depth, count = 1, 0
    stack[0] = root
    while depth > 0:
        depth -= 1
        node = stack[depth]
        apart = False
        for a in range(3):
            if boxes[node, a] > high[a] or boxes[node, a + 3] < low[a]:
                apart = True
        if apart:
            continue
        if links[node, LEFT] == NONE:
            found[count] = links[node, ITEM]
            count += 1
        else:
            depth = _push(stack, depth, links, node)
    return found[:count]


@kernel(allocates=True)
def along_ray(boxes, links, root, origin, direction):
    """Items whose box the ray meets, and where it enters (0 where it starts inside)."""
    stack = np.empty(len(links) + 1, np.int64)
    found = np.empty(len(links), np.int64)
    entry = np.empty(len(links), np.float64)
    depth, count = 1, 0
    stack[0] = root
    while depth > 0:
        depth -= 1
        node = stack[depth]
        near, far = 0.0, np.inf
        for a in range(3):
            if direction[a] == 0.0:  # never leaves its slab: in or out for good
                if origin[a] < boxes[node, a] or origin[a] > boxes[node, a + 3]:
                    far = -1.0
            else:
                t0 = (boxes[node, a] - origin[a]) / direction[a]
                t1 = (boxes[node, a + 3] - origin[a]) / direction[a]
                near = max(near, min(t0, t1))
                far = min(far, max(t0, t1))
        if near > far:
            continue
        if links[node, LEFT] == NONE:
            found[count] = links[node, ITEM]
            entry[count] = near
            count += 1
        else:
            depth = _push(stack, depth, links, node)
    return found[:count], entry[:count]
