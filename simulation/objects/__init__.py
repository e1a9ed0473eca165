"""Catalogue of objects that can meet the machine: bodies and their signatures for each kind of sensor."""
