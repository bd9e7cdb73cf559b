"""Files from clients: streamed to disk, hashed on the way, resumable by offset, inspected when whole.

Domains that take files come in by `taking` and `store`. Start at `store`, then `taking`.
"""
