"""Where the Gaussians of a registered reference are in a suspect model: placed, matched, confirmed, sketched.

Nothing here can see a chip: import-linter forbids keys, records and watermark to come in, and the bound on a false
claim rests on it (DESIGN 4.9). All rooms above may import it. Start at `registration_search.register`; `sketch` ranks
references by a few kilobytes each, to register only likely ones.
"""
