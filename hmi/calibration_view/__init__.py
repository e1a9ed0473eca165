"""Calibration wizards: the recording of a trial, and its result."""
