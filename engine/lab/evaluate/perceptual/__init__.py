"""What eyes may notice of a mark (suite 8): key views, and held-out views. Start at `study`."""
