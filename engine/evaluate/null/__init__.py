"""Calibration: measured false claims against the stated bound, power, detectability (suite 4)."""
