"""What the handlers share: who is asking, how errors are said, retries, lists, limits."""
