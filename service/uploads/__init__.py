"""Files from clients: streamed to disk, hashed on the way, resumable by offset, inspected when whole.

Start at `store`, then `ingest`.
"""
