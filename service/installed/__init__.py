"""What is installed under a name of its own (`pyproject.toml` maps the folders below this one to the top)."""
