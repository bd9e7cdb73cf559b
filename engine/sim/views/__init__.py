"""What happens between a render and the eye: lenses, shutters, tone curves, encoders; and moving pictures."""
