"""The ownership-verification service (arrives with its own issue)."""
