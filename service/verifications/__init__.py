"""Checking a suspect: the request (`endpoints`), and the steps that a worker runs (`flow`)."""
