"""Formats floor of the engine."""
