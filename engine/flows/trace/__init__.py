"""Traitor tracing: whose copies a suspect derives from, out of many records."""
