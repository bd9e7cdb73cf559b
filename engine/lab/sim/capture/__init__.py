"""Capture: from photos and point clouds to Gaussian models, with our own training.

Start at `photos` and `scans`; `trainer` is the training loop.
"""
