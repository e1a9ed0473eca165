"""Formats of field files: one module each, found by `known_formats`."""
