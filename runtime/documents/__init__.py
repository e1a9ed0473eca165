"""Generators of the documents in docs/: `make docs`."""
