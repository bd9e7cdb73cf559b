"""SPZ, Niantic's compressed stream. Start at `stream`."""
