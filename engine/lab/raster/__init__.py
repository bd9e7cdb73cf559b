"""The rasterizer as a torch operation, on the CPU by this package and on CUDA by gsplat."""
