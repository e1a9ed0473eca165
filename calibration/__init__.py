"""Calibration: values of a machine estimated from the messages of a trial, by pure functions (docs/hmi.md)."""
