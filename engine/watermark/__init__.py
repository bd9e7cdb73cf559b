"""The mark itself: keys and chips, plan and layout, evidence, statistics, claim, copies.

Records and flows come in; `registration` and `pictures` never do, or the theorem would lose its premise. Start at
`statistics` (the theorem), then `layout`, `planning` and `claim` (DESIGN 4.5, 4.8 and 4.9).
"""
