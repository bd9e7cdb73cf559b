"""Verification of a suspect: registration, evidence along three routes, and the decision."""
