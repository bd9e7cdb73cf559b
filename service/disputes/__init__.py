"""Disputes of two owners: the request and its consents (`endpoints`), steps and finding (`flow`)."""
