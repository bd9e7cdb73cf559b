"""What eyes may notice of a mark (suite 8): key views beside views that had no part in it. Start at `study`."""
