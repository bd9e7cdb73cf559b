"""Suspects as they were found: fetched or handed in, kept in a WARC file, logged and time-stamped."""
