"""Disputes of two owners: the request (`endpoints`), who may ask (`consent`), steps and finding (`flow`)."""
