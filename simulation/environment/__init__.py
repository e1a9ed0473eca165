"""Terrain, scenery, shed and the scene that sensors scan."""
