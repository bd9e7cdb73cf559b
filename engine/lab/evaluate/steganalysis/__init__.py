"""Can it be seen, without the key, that there is a mark: in pictures, or in the attributes of the model? (suite 5)

Start at `study`; `attributes` is what a stranger can measure, `learned` who learns from it.
"""
