"""Raster floor of the engine."""
