"""Views of a model: camera rigs, prepared sets of views, and what rendering them costs."""
