"""Tests of the tests: lines of the program that are broken on purpose, one at a time (`make mutants`)."""
