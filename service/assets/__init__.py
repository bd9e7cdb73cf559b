"""The registry over HTTP: what was marked, for whom, and its files in any format. Start at `endpoints`."""
