"""Embedding a mark: choose settings, prune, quantize, plan, settle strengths, draw the chips, write the record."""
