"""Monitors: vehicle, sensors, message time-outs, brake proof test, operator commands."""
