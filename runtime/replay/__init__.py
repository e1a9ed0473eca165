"""Replay of recorded logs through the stack."""
