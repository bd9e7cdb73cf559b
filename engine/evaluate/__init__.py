"""Studies: what is measured, against which bar, and how it is reported. Only the command line comes in.

Start at `study` (cells, bars, sections), then `running` (resumable, in several processes) and `reporting`; `studies`
lists them by name. A folder is one study; its `study` module says what it asks.
"""
