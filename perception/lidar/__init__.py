"""Lidar: ground, clusters, boxes, health, and the node that runs them on each scan."""
