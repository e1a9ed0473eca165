"""Replanning around static obstacles."""
