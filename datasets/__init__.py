"""Logs: codec, MCAP writer and reader, viewer topics beside the messages, importers of others' recordings."""
