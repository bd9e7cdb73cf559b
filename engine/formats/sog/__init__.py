"""SOG, PlayCanvas's zip of lossless WebP images. Start at `bundle`."""
