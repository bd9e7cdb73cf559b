"""Capture: from photos and point clouds to Gaussian models."""
