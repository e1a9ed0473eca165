"""Logs: codec, MCAP writer and reader, viewer topics, importers of recordings."""
