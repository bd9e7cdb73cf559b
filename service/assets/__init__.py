"""The registry: what was marked, for whom, and its files."""
