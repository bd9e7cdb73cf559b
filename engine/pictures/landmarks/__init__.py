"""Landmarks of a model: keypoints of its renders with their places in the world, and their matching."""
