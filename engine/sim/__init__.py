"""Sim floor of the engine."""
