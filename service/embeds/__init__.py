"""Marking a model: the request (`endpoints`), and the steps that a worker runs (`flow`, where to start)."""
