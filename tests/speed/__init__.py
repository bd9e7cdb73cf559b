"""How fast this checkout is beside another: the same work by both in turn, in one run on one machine.

`python -m tests.speed OTHER_CHECKOUT [PART ...]`. Nothing here is a test; docs/RESULTS.md holds what it printed.
"""
