"""Suspects, preserved as found: fetched or uploaded, kept in a WARC file, logged and time-stamped."""
