"""Where on an asset the mark is, and maps that show it."""
