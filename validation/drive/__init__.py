"""Measures and report of one drive."""
