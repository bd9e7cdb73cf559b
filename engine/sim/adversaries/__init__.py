"""Adversaries: whoever has marked models and wants the mark gone, diluted, or on somebody else's work.

Import what you need from the modules: purification, evolution, collusion, overwriting, transplant.
"""
