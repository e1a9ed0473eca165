"""Obstacle sources: lidar, radar and ultrasonic returns for the raw protective field."""
