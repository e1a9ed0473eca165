"""Upload of totals and alarms to a platform: a queue on disk that survives being off-line, and its sender."""
