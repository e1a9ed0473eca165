"""Lidar: ground, clusters, boxes, health, and the node that computes them from each scan."""
