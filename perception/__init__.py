"""Perception: obstacles per sensor, fused tracks and the health of each sensor, from raw sensor data."""
