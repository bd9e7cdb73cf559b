"""Evaluate floor of the engine."""
