"""What happens between a render and the eye: lenses, shutters, tone curves, encoders; and moving pictures.

Image attacks come in by `engine.lab.sim.attacks`, films by scenarios. Start at `tones`, the plainest of them.
"""
