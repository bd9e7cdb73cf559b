"""Flows by use case: `embed`, `verify`, `trace`, `dispute`, `regions`; `records` and `views` serve them all.

Command line, service, scenes and laboratory enter by these; the theory is a floor below, in `watermark`. Start at
`embed.embedding` and `verify.search`.
"""
