"""Traces of a JPEG coder in a picture: where its blocks begin, its quality, and the score of its quantizer."""
