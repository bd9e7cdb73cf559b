"""Which of many assets is it? An index over what every registered asset looks like, as a model and in pictures.

It ranks; it proves nothing. Nothing here can see a chip (import-linter forbids it), so that what is tested, and how
many tries are counted, follows from geometry and looks alone (DESIGN 4.9). Start at `catalogue.Catalogue`.
"""
