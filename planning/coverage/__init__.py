"""Headland passes, swaths and their order."""
