"""Judges what happened from logs alone: measures, verdicts by clause, and the report; runs nothing."""
