"""Radar: Doppler over ground, clusters, what repeats, health, and the nodes that run them on each cycle."""
