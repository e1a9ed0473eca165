"""Drives along a path: steering, speed and brake, implement; what it wants is a wish until the supervisor agrees."""
