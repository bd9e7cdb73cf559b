"""OpenUSD with ParticleField3DGaussianSplat. Start at `scene`; `process` is what opens files of others."""
