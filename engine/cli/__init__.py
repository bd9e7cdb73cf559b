"""Cli floor of the engine."""
