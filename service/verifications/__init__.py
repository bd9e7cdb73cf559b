"""Checking a suspect: the request (`endpoints`), the records to compare (`candidates`), the steps (`flow`)."""
