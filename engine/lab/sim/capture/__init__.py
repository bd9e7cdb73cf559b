"""Capture: from photos and point clouds to Gaussian models, with our own training.

Scenarios, re-training thieves and studies come in. Start at `from_colmap` (photos) and `from_points` (scans);
`training` is the loop of both.
"""
