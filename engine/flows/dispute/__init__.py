"""Disputes between two claimants of one asset."""
