"""Odometry from IMU, wheels and steering."""
