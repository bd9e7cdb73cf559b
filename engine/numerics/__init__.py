"""Numerics floor of the engine."""
