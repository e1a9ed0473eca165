"""Consistency of the inputs of an evaluation: odometry, mounts, ring model, times and truth."""
