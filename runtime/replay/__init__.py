"""Recorded logs run through the stack."""
