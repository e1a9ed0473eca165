"""Importers of recordings, one file per format: each yields a description and a stream of Headland messages."""
