"""Ultrasonic: confirmed echoes, obstacles in the near field, health, and the nodes that run them."""
