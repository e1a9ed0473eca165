"""Headland rounds, swaths and their order."""
