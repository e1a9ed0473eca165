"""Recordings of others, one file a format: each becomes a description and a stream of Headland's messages."""
