"""The flows: embed a mark, verify a suspect, trace copies, choose settings. Whatever is done with a mark goes by here.

Command line, simulator, studies and service come in by these; the theory is a floor below, in `watermark`. Start at
`embedding` and `searching`; `sealing` is the way between a record and what the flows work with.
"""
