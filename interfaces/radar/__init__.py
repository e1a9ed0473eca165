"""Radars by their own protocols, as `RadarScan`."""
