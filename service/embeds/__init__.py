"""Marking a model: the request, and the flow that a worker runs."""
