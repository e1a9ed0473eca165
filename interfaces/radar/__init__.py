"""Radars by their protocols, as `RadarScan`."""
