"""Terrain, scenery, shed and the scene for ray casting."""
