"""Physics: bodies of tetrahedra that carry Gaussians, moved by extended position-based dynamics (XPBD).

`body` makes a body of a model and poses it again, `world` steps bodies and obstacles and measures energy,
`deformations` bends, twists and squashes in closed form. Nothing is imported here: the attacks come
by this package, and their list must load at once.
"""
