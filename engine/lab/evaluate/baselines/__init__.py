"""Other methods, runnable: on the same scenes, at the same fidelity, under the same attacks as ours (suite 6).

The stability study comes in, too. Start at `methods`, the small interface that a method stands behind.
"""
