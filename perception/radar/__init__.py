"""Radar: Doppler over ground, clusters, tracklets, health, and the nodes that run them on each cycle."""
