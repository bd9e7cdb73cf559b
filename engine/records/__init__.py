"""What the owner keeps of one embedding: a versioned, sealed, deterministic file that holds the unmarked reference.

Pipeline and whatever stands on it come in by `record.Record` (`to_bytes`, `from_bytes`); `header` is the part that is
readable without a key, `reference` the codec of the unmarked model.
"""
