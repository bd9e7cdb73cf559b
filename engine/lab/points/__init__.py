"""Point clouds from scanners and reconstructions: PLY, PCD, LAS, COLMAP. Start at `reading`."""
