"""What a picture shows of a model: its camera, its alignment, its light and tone, and the residual that is left.

Nothing here can see a chip: import-linter forbids keys, records and watermark to come in, and the bound on a false
claim rests on it (DESIGN 4.9). All rooms above may import it. Start at `camera.camera_search.find_camera`, then
`alignment.planar` and `residual`.
"""
