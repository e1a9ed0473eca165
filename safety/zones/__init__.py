"""Protective field, swept area, footprint, geofence and known structure."""
