"""The engine behind `mark3dgs`, the package that users import: formats, pictures, statistics and the flows of a mark.

How it is built: docs/DESIGN.md.
"""
