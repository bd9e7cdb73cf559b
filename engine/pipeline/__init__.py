"""Pipeline floor of the engine."""
