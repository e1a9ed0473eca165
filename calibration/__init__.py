"""Calibration: values of a machine estimated from the messages of a trial, as pure functions on arrays (docs/hmi.md)."""
