"""Checking a suspect: the request (`endpoints`), whom it is held against (`candidates`), the steps (`flow`)."""
