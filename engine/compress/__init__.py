"""How little of a model the views need: impact, uncertainty, pruning, merging, and the quantiser of colours.

Keys and marks stand above and may come in; nothing here knows of them. Start at `impact`, then `pruning` and `hvq`
(DESIGN 4.2 to 4.4).
"""
