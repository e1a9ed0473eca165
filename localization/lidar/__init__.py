"""Lidar odometry and localization in a lidar map."""
