"""Docking in reverse into a bay of the shed and undocking forward: paths with cusps, clear of walls and posts."""
