"""Studies: what is measured, against which bar, and how it is reported. Only the command line comes in.

Start at `study` (cells, bars, sections), then `cell_runner` (resumable, in several processes) and `report`; `suites`
lists them by name, `measurements` holds those that print rows only. A folder is one study; its
`NAME_study` module says what it measures.
"""
