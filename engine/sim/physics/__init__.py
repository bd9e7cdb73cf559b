"""Physics: bodies of tetrahedra that carry Gaussians, moved by extended position-based dynamics (XPBD)."""
