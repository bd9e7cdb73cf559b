"""PLY: INRIA's Gaussians (`gaussians`) and SuperSplat's compressed ones (`compressed`), on one strict header parser."""
