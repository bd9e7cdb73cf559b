"""Compress floor of the engine."""
