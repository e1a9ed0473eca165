"""Packet captures: container, network layers, and one decoder module per maker."""
