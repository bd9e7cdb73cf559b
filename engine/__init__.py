"""Mark3DGS: ownership watermarks for 3D Gaussian Splatting models."""
