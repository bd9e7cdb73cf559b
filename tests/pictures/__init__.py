"""Tests of engine.pictures."""
