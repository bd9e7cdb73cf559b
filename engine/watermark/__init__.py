"""Watermark floor of the engine."""
