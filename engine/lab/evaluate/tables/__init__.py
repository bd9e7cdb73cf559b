"""Study: tables 1 to 6 and figures 6 and 7 of the paper on our scenes, and what each stage buys.

A table or figure is a module of `sections`, what it measures is in `cells`. Start at `part`.
"""
