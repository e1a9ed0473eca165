"""Ultrasonic: echoes that repeat, the near field they show, health, and the nodes that run them."""
