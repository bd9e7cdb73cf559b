"""Functions of the suites that print rows (`measurements`)."""
