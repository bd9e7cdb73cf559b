"""Checking a suspect: the request, and the flow that a worker runs."""
