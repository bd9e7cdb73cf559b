"""Tests of engine.registration."""
