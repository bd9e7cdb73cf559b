"""What eyes may notice of a mark."""
