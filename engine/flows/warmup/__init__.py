"""Kernels made ready before a job begins."""
