"""Where the Gaussians of a registered reference are in a suspect model: placed, matched, judged, sketched.

Nothing here can see a chip: import-linter forbids keys, records and watermark to come in, and the bound on a false
claim rests on it (DESIGN 4.9). Everybody above may come in. Start at `registration_search.register`; `sketch` tells
from a few kilobytes which references are worth registering at all.
"""
