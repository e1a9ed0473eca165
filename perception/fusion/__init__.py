"""Sensor fusion: one list of tracks from the obstacles of all sensors."""
