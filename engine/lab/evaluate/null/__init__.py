"""Calibration: measured false claims against the stated bound, and power (suite 4).

Start at `study`; `suspects` are those whom no key may claim, `rates` adds up the counts.
"""
